"""Dense antipodal grasps."""

from __future__ import annotations

import numpy as np
import pytest

import regrasp_gym  # noqa: F401
from regrasp_bench.oracle.antipodal import GripperShapes, sample_grasps
from regrasp_bench.peers.coal_shapes import PosedShapes, Shape, keeps_margins
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_planner import ConvexBody
from regrasp_planner.task import Body


@pytest.mark.parametrize(
    ("name", "sink"), [("003_cracker_box", 1e-4), ("005_tomato_soup_can", 2e-3), ("006_mustard_bottle", 2e-3)]
)
def test_pads_touch_from_both_sides_and_clear_the_target_when_open(robot, coarse, name, sink):
    target, gripper = OBJECTS[name].body(), robot.gripper
    grasps = sample_grasps(target, gripper, coarse)
    assert len(grasps.thetas) > 20
    shapes = GripperShapes(gripper)
    pads = [shapes.palms + int(i) for i in np.asarray(gripper.contact)]
    pieces = [Shape.of(piece) for piece in target.pieces]
    still = PosedShapes(pieces, np.tile(np.eye(3), (len(pieces), 1, 1)), np.zeros((len(pieces), 3)))

    def pads_at(thetas, pad):
        posed = shapes.at(grasps.rotations, grasps.positions, thetas)
        return PosedShapes([shapes.shapes[pad]], posed.rotations[:, [pad]], posed.positions[:, [pad]])

    for pad in pads:
        assert keeps_margins(pads_at(grasps.openings, pad), still, coarse.finger_margin - 1e-6).all()
        # Where sides slant, the point that touches first lies between those of the cloud.
        assert keeps_margins(pads_at(grasps.thetas + sink, pad), still, 0.0).mean() > (0.95 if sink > 1e-3 else 0.999)
        assert not keeps_margins(pads_at(grasps.thetas - 1e-4, pad), still, 0.0).any()


def test_a_box_is_taken_by_its_narrow_sides_only(robot, coarse):
    grasps = sample_grasps(OBJECTS["003_cracker_box"].body(), robot.gripper, coarse)
    closing = grasps.rotations @ np.asarray(robot.gripper.width_axis)
    np.testing.assert_allclose(np.abs(closing), np.tile([1.0, 0, 0], (len(closing), 1)), atol=1e-9)
    np.testing.assert_allclose(2 * grasps.thetas, 0.0718, atol=1e-6)


def test_what_is_too_wide_has_no_grasp(robot, coarse):
    wide = Body("crate", (ConvexBody.box((0.1, 0.12, 0.14)),), np.zeros(3))
    assert len(sample_grasps(wide, robot.gripper, coarse).thetas) == 0
