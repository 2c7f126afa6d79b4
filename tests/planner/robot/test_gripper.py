"""The reduced gripper contains the gripper, and gaps and finger coordinates belong together."""

import numpy as np
from scipy.spatial import ConvexHull

from regrasp_planner.robot.gripper import finger_coordinate, gripper_points, pad_gap, reduce_gripper

GRASPS = 3


def test_the_points_enclose_the_gripper_at_every_opening(panda, build):
    gripper = panda.gripper
    theta = np.linspace(0.0, 0.04, GRASPS)
    palm, *fingers = gripper_points(gripper, np.tile(build.pose(), (GRASPS, 1)), theta)
    bodies = [gripper.palm[k] for k in range(gripper.palm.batch_size)]
    planes = ConvexHull(palm[0]).equations
    for body in bodies:
        heights = body.hull_vertices() @ planes[:, :3].T + planes[:, 3]
        assert (heights + float(body.radius)).max() < 1e-9
    for k, (finger, side) in enumerate(zip(fingers, (1, -1), strict=True)):
        for at, opening in zip(finger, theta, strict=True):
            planes = ConvexHull(at).equations
            moved = gripper.fingers[k].hull_vertices() + np.array([0, side * opening, 0])
            assert (moved @ planes[:, :3].T + planes[:, 3]).max() < 1e-9


def test_the_points_move_with_the_gripper(panda, build):
    theta = np.array([0.01])
    at_origin = gripper_points(panda.gripper, build.pose()[None], theta)
    turned = gripper_points(panda.gripper, build.pose((0.1, 0.2, 0.3), (0, 0, np.pi / 2))[None], theta)
    for before, after in zip(at_origin, turned, strict=True):
        x, y, z = before[0].T
        np.testing.assert_allclose(after[0], np.stack([0.1 - y, 0.2 + x, 0.3 + z], 1), atol=1e-12)


def test_gap_and_finger_coordinate_are_inverse(panda):
    reduced = reduce_gripper(panda.gripper)
    assert reduced.travel == 1.0
    for theta in (0.0, 0.013, 0.04):
        gap = pad_gap(panda.gripper, theta)
        assert abs(gap - pad_gap(panda.gripper, 0.0) - 2 * theta) < 1e-9
        np.testing.assert_allclose(finger_coordinate(panda.gripper, gap), theta, atol=1e-9)
    # Widths beyond the range give its ends.
    np.testing.assert_array_equal(finger_coordinate(panda.gripper, np.array([-1.0, 1.0])), [0.0, 0.04])


def test_the_gripper_is_reduced_once(panda):
    assert reduce_gripper(panda.gripper) is reduce_gripper(panda.gripper)
