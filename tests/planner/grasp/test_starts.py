"""Initial grasps against certified distances."""

import numpy as np
import pytest

from regrasp_planner.grasp.closing_axes import closing_axes
from regrasp_planner.grasp.starts import grasp_starts
from regrasp_planner.robot.gripper import reduce_gripper


@pytest.mark.parametrize("target", ["box", "can"], indirect=True)
def test_starts_touch_with_both_pads_and_keep_the_palm_off(panda, target, hand, gap):
    hull, gripper = target.hull_vertices(), panda.gripper
    axes, _ = closing_axes(hull, 0.08, 4)
    starts = grasp_starts([hull], 0, axes, gripper, 12, 0.005)
    palm = reduce_gripper(gripper).hand[0]
    deep = np.flatnonzero(starts.depths > 0.005)
    assert len(deep) > 20
    for pose, theta in list(zip(starts.poses[deep], starts.thetas[deep], strict=True))[::5]:
        assert gap(palm, pose, target.pieces[0], [1, 0, 0, 0, 0, 0, 0]) > 2e-3
        fingers = hand.fingers(gripper, pose, theta)
        for k in np.asarray(gripper.contact):
            assert abs(gap(target.pieces[0], [1, 0, 0, 0, 0, 0, 0], *fingers[int(k)])) < 4e-4
