"""Peers of IkSolve, and the benchmark of inverse kinematics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import regrasp_gym
from regrasp_bench.peers.coal_checker import ExactChecker
from regrasp_bench.peers.mink_ik import MinkPeer, exhaustive_search, pose_errors, reaches
from regrasp_bench.tables.ik import grasp_queries, ik, random_queries, summarise
from regrasp_gym.reports.trials import read_records
from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.stages.collision_models import CollisionModels
from regrasp_planner.stages.options import MotionOptions

THETA = 0.04


@pytest.fixture(scope="module")
def world() -> Any:
    env = gymnasium.make("regrasp_gym/PandaYCB-v0")
    env.reset(seed=3)
    return regrasp_gym.PlannerExpert(env).env


@pytest.fixture(scope="module")
def checker(world: Any) -> ExactChecker:
    task = world.task()
    models = CollisionModels(world.planner_robot, task.target, task.pick.obstacles, MotionOptions())
    return ExactChecker(models.empty_handed(task.pick.target_pose), THETA)


@pytest.fixture(scope="module")
def limits(world: Any) -> tuple[np.ndarray, np.ndarray]:
    arm = world.planner_robot.arm
    return np.asarray(arm.lower, float), np.asarray(arm.upper, float)


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


def test_margins_are_kept_where_the_planner_certifies_them(checker: ExactChecker, world: Any, limits: Any) -> None:
    task = world.task()
    models = CollisionModels(world.planner_robot, task.target, task.pick.obstacles, MotionOptions())
    model = models.empty_handed(task.pick.target_pose)
    q = np.random.default_rng(2).uniform(*limits, (200, 7))
    kept = checker.keeps_margins(q)
    value = configuration_clearance(model, q, THETA, cap=0.02, exact=True).value
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
        answer = exhaustive_search(checker, target, *limits, rng)
        assert answer is not None
        assert reaches(checker, answer, target)
        assert checker.keeps_margins(answer[None])[0]
        assert ((answer >= limits[0]) & (answer <= limits[1])).all()
        found += 1


def test_the_search_finds_nothing_out_of_reach(checker: ExactChecker, limits: Any) -> None:
    target = np.eye(4)
    target[:3, 3] = [1.6, 0.0, 0.4]
    assert exhaustive_search(checker, target, *limits, np.random.default_rng(0), starts=512) is None
    under = checker.frames(np.zeros((1, 7)))[0, -2].copy()
    under[:3, 3] = [0.5, 0.0, -0.2]
    assert exhaustive_search(checker, under, *limits, np.random.default_rng(0), starts=512) is None


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
            assert reaches(checker, result.q, target)
            assert checker.free(result.q[None])
    assert solved >= 2
    far = np.eye(4)
    far[:3, 3] = [1.6, 0.0, 0.4]
    result = mink.solve(checker, far, starts[:3])
    assert (result.q, result.starts, result.reached) == (None, 3, 0)


def test_queries_are_of_their_kind(world: Any) -> None:
    task, robot = world.task(), world.planner_robot
    queries = random_queries(task, robot, 2, np.random.default_rng(0))
    assert sorted(query.kind for query in queries) == ["random"] * 2 + ["random, close"] * 2
    grasps = grasp_queries(task, robot, 2)
    assert {query.kind for query in grasps} <= {"grasp at pick", "grasp at place"}
    for query in grasps:
        scene = task.pick if query.kind == "grasp at pick" else task.place
        assert np.linalg.norm(query.target[4:] - scene.target_pose[4:]) < 0.2


def test_a_wrong_answer_counts_as_missed() -> None:
    ours = {"found": True, "solved": False, "seconds": 0.1, "message": "", "seconds_in_batch": 0.02}
    mink = {"found": True, "solved": True, "seconds": 0.01, "starts": 3, "first_reached": False}
    queries = [
        {"kind": "random", "solvable": True, "ours": ours, "mink": mink},
        {"kind": "random", "solvable": True, "ours": ours | {"solved": True}, "mink": mink},
        {"kind": "grasp at pick", "solvable": False, "ours": ours, "mink": mink},
    ]
    figures = summarise({}, [{"trial": 7, "queries": queries}, {"trial": 8, "crashed": "ValueError: no"}])
    everything = figures["kinds"]["all"]
    assert (everything["poses"], everything["left_out"]) == (2, 1)
    assert (everything["ours"]["solved"], everything["ours"]["wrong"], everything["mink"]["solved"]) == (1, 1, 2)
    assert everything["missed"] == [(7, 0, "")]
    assert figures["crashed"] == {"ValueError: no": [8]}


@pytest.mark.slow
def test_the_benchmark_of_two_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    records, json_file, plot_file = tmp_path / "r.jsonl", tmp_path / "ik.json", tmp_path / "ik.svg"
    ik(scenes=1, random_poses=2, grasps=1, records=records)
    ik(scenes=2, random_poses=2, grasps=1, records=records, json_file=json_file, plot_file=plot_file)
    shown = capsys.readouterr().out
    assert "1 of 2 are in" in shown.replace("\n", " ")
    assert "mink" in shown
    assert len(read_records(records)) == 2
    report = json.loads(json_file.read_text())
    assert report["crashed"] == {}
    assert report["versions"]["mink"]
    figures = report["kinds"]["all"]
    assert figures["poses"] >= 8
    assert figures["ours"]["solved"] == figures["poses"] - len(figures["missed"]) >= 7
    assert figures["ours"]["wrong"] == 0
    assert plot_file.stat().st_size > 5000
