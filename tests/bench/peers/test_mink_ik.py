"""Peers of IkSolve."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.mink_ik import MinkPeer, exhaustive_search, is_at_target, pose_errors
from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import CollisionModel

THETA = 0.04


@pytest.fixture(scope="module")
def checker(empty_handed: CollisionModel) -> ExactChecker:
    return ExactChecker(empty_handed, THETA)


@pytest.fixture(scope="module")
def limits(checker: ExactChecker) -> tuple[np.ndarray, np.ndarray]:
    return checker.lower, checker.upper


def test_the_gripper_is_where_mujoco_has_it(world: Any, checker: ExactChecker, limits: Any) -> None:
    robot = world.scenario.robot
    model = robot.build_spec().compile()
    data = mujoco.MjData(model)
    at = [model.joint(name).qposadr[0] for name in robot.arm_joints]
    for q in np.random.default_rng(0).uniform(*limits, (20, 7)):
        data.qpos[at] = q
        mujoco.mj_kinematics(model, data)
        site = data.site(robot.tcp_site)
        gripper = checker.frames(q[None])[0, -2]
        assert gripper[:3, 3] == pytest.approx(site.xpos, abs=1e-9)
        assert gripper[:3, :3] == pytest.approx(site.xmat.reshape(3, 3), abs=1e-9)


vectors = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)


@settings(max_examples=50, deadline=None)
@given(vectors, vectors, vectors, vectors)
def test_errors_are_what_brings_the_gripper_to_the_target(a: Any, b: Any, turn_a: Any, turn_b: Any) -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = a, b
    poses[:, :3, :3] = Rotation.from_rotvec([turn_a, turn_b]).as_matrix()
    missing, turn = pose_errors(poses[0], poses[1])
    assert poses[0, :3, 3] + missing == pytest.approx(b, abs=1e-12)
    assert Rotation.from_rotvec(turn).as_matrix() @ poses[0, :3, :3] == pytest.approx(poses[1, :3, :3], abs=1e-9)


def test_margins_are_kept_where_the_planner_certifies_them(
    checker: ExactChecker, empty_handed: CollisionModel, limits: Any
) -> None:
    q = np.random.default_rng(2).uniform(*limits, (200, 7))
    kept = checker.keeps_margins(q)
    value = configuration_clearance(empty_handed, q, THETA, cap=0.02, exact=True).value
    assert kept[value >= 0].all()
    # The certificates understate distances by a fraction of a millimetre, no more.
    assert not kept[value < -1e-3].any()
    assert 0.1 < kept.mean() < 0.95


def test_the_search_finds_what_is_known_to_exist(checker: ExactChecker, limits: Any) -> None:
    rng = np.random.default_rng(1)
    found = 0
    while found < 5:
        q = rng.uniform(*limits)
        if not checker.keeps_margins(q[None])[0]:
            continue
        target = checker.frames(q[None])[0, -2]
        answer = exhaustive_search(checker, target, rng)
        assert answer is not None
        assert is_at_target(checker, answer, target)
        assert checker.keeps_margins(answer[None])[0]
        assert ((answer >= limits[0]) & (answer <= limits[1])).all()
        found += 1


def test_the_search_finds_nothing_out_of_reach(checker: ExactChecker) -> None:
    target = np.eye(4)
    target[:3, 3] = [1.6, 0.0, 0.4]
    assert exhaustive_search(checker, target, np.random.default_rng(0), starts=512) is None
    under = checker.frames(np.zeros((1, 7)))[0, -2].copy()
    under[:3, 3] = [0.5, 0.0, -0.2]
    assert exhaustive_search(checker, under, np.random.default_rng(0), starts=512) is None


def test_mink_reaches_poses_and_says_so(checker: ExactChecker, world: Any, limits: Any) -> None:
    mink = MinkPeer(world.scenario)
    rng = np.random.default_rng(4)
    starts = rng.uniform(*limits, (64, 7))
    solved = 0
    for q in rng.uniform(*limits, (8, 7)):
        if not checker.free(q[None]):
            continue
        target = checker.frames(q[None])[0, -2]
        result = mink.solve(checker, target, starts)
        assert result.reached >= (result.q is not None)
        if result.q is not None:
            solved += 1
            assert is_at_target(checker, result.q, target)
            assert checker.free(result.q[None])
    assert solved >= 2
    far = np.eye(4)
    far[:3, 3] = [1.6, 0.0, 0.4]
    result = mink.solve(checker, far, starts[:3])
    assert (result.q, result.starts, result.reached) == (None, 3, 0)
