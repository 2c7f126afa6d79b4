"""Straight lines of the gripper, and the kinematics on the host that follow them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp_planner.ik.line import ArmKinematics, follow_line
from regrasp_planner.robot.kinematics import forward_kinematics


@pytest.fixture(scope="module")
def robot(panda):
    return panda


def test_kinematics_on_the_host_are_those_of_the_robot(robot):
    kinematics = ArmKinematics(robot.arm)
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.arm.lower, robot.arm.upper, (20, 7)):
        place, jacobian = kinematics.gripper(q)
        expected = np.asarray(forward_kinematics(robot.arm, q))[-1]
        np.testing.assert_allclose(place[:3, 3], expected[4:], atol=1e-12)
        h = 1e-6
        for j in range(7):
            ahead, behind = kinematics.gripper(q + h * np.eye(7)[j])[0], kinematics.gripper(q - h * np.eye(7)[j])[0]
            np.testing.assert_allclose((ahead - behind)[:3, 3] / (2 * h), jacobian[:3, j], atol=1e-8)
            spin = (ahead - behind)[:3, :3] @ place[:3, :3].T / (2 * h)
            np.testing.assert_allclose([spin[2, 1], spin[0, 2], spin[1, 0]], jacobian[3:, j], atol=1e-8)


def test_a_line_goes_on_with_the_other_joints_when_one_is_at_its_limit(robot):
    kinematics = ArmKinematics(robot.arm)
    # Not the symmetric home, where the joints that could help are singular.
    start = np.asarray(robot.home) + np.array([0.3, 0.2, 0.5, 0.1, -0.4, 0.2, 0])
    kinematics.upper = kinematics.upper.copy()
    kinematics.upper[1] = start[1] + 0.02
    line = follow_line(kinematics, start, np.array([0.08, 0, 0]))
    assert line.fraction == 1.0
    assert line.configurations[:, 1].max() <= kinematics.upper[1] + 1e-12
    ends = [kinematics.gripper(q)[0] for q in line.configurations[[0, -1]]]
    np.testing.assert_allclose(ends[1] - ends[0], np.pad([[0.08], [0], [0]], ((0, 1), (3, 0))), atol=1e-4)


def test_a_line_may_turn_the_gripper_on_the_way(robot):
    kinematics, start = ArmKinematics(robot.arm), np.asarray(robot.home)
    turn = np.array([0.0, 0.0, 0.3])
    line = follow_line(kinematics, start, np.array([0.0, 0.0, 0.05]), turn)
    assert line.fraction == 1.0
    first, last = (kinematics.gripper(q)[0] for q in line.configurations[[0, -1]])
    np.testing.assert_allclose(last[:3, 3] - first[:3, 3], [0, 0, 0.05], atol=1e-4)
    np.testing.assert_allclose(last[:3, :3], Rotation.from_rotvec(turn).as_matrix() @ first[:3, :3], atol=1e-4)


def test_a_line_beyond_the_arm_ends_where_it_stretches(robot):
    line = follow_line(ArmKinematics(robot.arm), np.asarray(robot.home), np.array([0.9, 0, 0]), coarse=True)
    assert 0.1 < line.fraction < 1.0
