"""Overlaps of bounding boxes against the bodies in them."""

import numpy as np

from regrasp_planner.geometry.boxes import bounding_boxes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.broad_phase import overlaps
from regrasp_planner.robot.gripper import gripper_points


def test_bounding_boxes_overlap_where_the_bodies_do(panda, build, hand, gap):
    """Corners inside of a box make them overlap, and they are never farther apart than the bodies in them."""
    gripper = panda.gripper
    rng = np.random.default_rng(0)
    quaternions = rng.normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    poses = np.concatenate([quaternions, rng.normal(scale=0.12, size=(200, 3))], axis=1)
    opened = np.full(200, 0.03)
    block = ConvexBody.stack([ConvexBody.box((0.1, 0.06, 0.04))])
    total, least = overlaps(poses, opened, gripper, bounding_boxes(block), build.pose()[None], 0.005)
    corners = np.concatenate(gripper_points(gripper, poses, opened), axis=1)
    inside = (np.abs(corners) < [0.05, 0.03, 0.02]).all(axis=2).any(axis=1)
    assert inside.sum() > 10
    assert (least[inside] <= 0).all()
    assert ((total == 0) == (least >= 0.005)).all()
    for pose, size in zip(poses[::20], least[::20], strict=True):
        parts = [*hand.palm(gripper, pose), *hand.fingers(gripper, pose, 0.03)]
        # Boxes are larger than what is in them.
        assert min(gap(block[0], build.pose(), *part) for part in parts) >= size - 1e-6
