"""The one hollow object that is shipped: wider than the gripper opens, and taken by its rim or its handle."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from standing import upright

import regrasp_gym
from regrasp_gym.errors import SceneError
from regrasp_gym.objects import OBJECTS, solid
from regrasp_gym.objects.shapes import lathe
from regrasp_gym.robots.panda import PANDA
from regrasp_gym.scenes.graspable import graspable_by_part
from regrasp_gym.scenes.resting import resting_poses, upright_pose
from regrasp_gym.scenes.table_shelf import make_scene
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig, check_target
from regrasp_planner import Body, ConvexBody, Grasp, Obstacle, Scene, generate_grasps, stable_poses
from regrasp_planner.robot.model import Gripper

MUG = OBJECTS["025_mug"]
OPENING = 0.076


@pytest.fixture(scope="module")
def gripper() -> Gripper:
    return PANDA.planner_robot().gripper


@pytest.fixture(scope="module")
def grasps(gripper: Gripper) -> tuple[Grasp, ...]:
    table = Body("table", (ConvexBody.box((1.0, 1.0, 0.04)),), np.zeros(3))
    obstacle = Obstacle(table, np.array([1.0, 0, 0, 0, 0, 0, -0.02]))
    return generate_grasps(MUG.body(), (Scene("pick", upright(MUG), (obstacle,)),), gripper).grasps


def bodies(gripper: Gripper, grasp: Grasp, theta: float) -> list[np.ndarray]:
    """Vertices of palm and fingers in the frame of the mug."""
    turn = Rotation.from_quat(grasp.pose[:4], scalar_first=True)
    placed = [gripper.palm[k].hull_vertices() for k in range(gripper.palm.batch_size)]
    for k, finger in enumerate(np.asarray(gripper.finger_of)):
        placed.append(gripper.fingers[k].hull_vertices() + theta * np.asarray(gripper.screws)[finger, :3])
    return [turn.apply(points) + grasp.pose[4:] for points in placed]


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Radius of the largest ball in both hulls, metres; negative if they are apart. By linear programming."""
    planes = np.concatenate([ConvexHull(a).equations, ConvexHull(b).equations])
    system = np.column_stack([planes[:, :3], np.ones(len(planes))])
    found = linprog([0, 0, 0, -1.0], A_ub=system, b_ub=-planes[:, 3], bounds=[(None, None)] * 4)
    assert found.success
    return float(found.x[3])


def test_grasps_hold_a_wall_or_the_handle_and_pierce_nothing(gripper: Gripper, grasps: tuple[Grasp, ...]) -> None:
    assert len(grasps) >= 2
    for grasp in grasps:
        assert 2 * grasp.theta < 0.03, "as thick as a wall or the handle, not as the mug"
        deepest = max(overlap(part, piece) for part in bodies(gripper, grasp, grasp.opening) for piece in MUG.pieces)
        assert deepest < 1e-4, "nothing of the open gripper is inside of the mug's walls"
        # The mug's matter lies on the line between the pads.
        axis = Rotation.from_quat(grasp.pose[:4], scalar_first=True).apply(np.asarray(gripper.width_axis))
        line = grasp.pose[4:] + np.linspace(-grasp.theta, grasp.theta, 21)[:, None] * axis
        hulls = [ConvexHull(piece).equations for piece in MUG.pieces]
        inside = np.max([(line @ h[:, :3].T + h[:, 3] < 1e-4).all(axis=1) for h in hulls], axis=0)
        assert inside.mean() > 0.8


def test_stable_poses_are_those_of_the_hull_of_the_whole() -> None:
    body = MUG.body()
    whole = ConvexHull(np.concatenate(MUG.pieces))
    found = stable_poses(body.hull_vertices(), body.center_of_mass)
    for direction in found.directions:
        assert np.abs(whole.equations[:, :3] - direction).max(axis=1).min() < 1e-6
    share = found.probability[found.directions @ [0, 0, -1] > 0.999].sum()
    assert share == pytest.approx(upright_pose(MUG).probability, abs=0.05)


def test_it_counts_as_graspable_and_solid_things_of_its_size_do_not() -> None:
    assert all(graspable_by_part(MUG, pose, OPENING) for pose in resting_poses(MUG))
    block = solid("block", "block", 0.3, [lathe([(46.5e-3, 0), (46.5e-3, 81e-3)], 24)])
    assert not any(graspable_by_part(block, pose, OPENING) for pose in resting_poses(block))
    check_target(MUG, TableShelfConfig())
    with pytest.raises(SceneError, match="'block' is 81 mm wide"):
        check_target(block, TableShelfConfig())


def test_a_wall_that_no_finger_gets_behind_does_not_count() -> None:
    """A bowl whose cavity is too narrow for a finger."""
    rings = [(46.5e-3, 46.5e-3 - 8e-3), (46.5e-3, 4e-3)]
    turns = np.linspace(0, 2 * np.pi, 13)
    open_, narrow = (
        solid(
            "bowl",
            "bowl",
            0.3,
            [
                np.array([[r * np.cos(a), r * np.sin(a), z] for r in ring for a in turns[k : k + 2] for z in (0, 0.08)])
                for k in range(12)
            ],
        )
        for ring in rings
    )
    assert graspable_by_part(open_, upright_pose(open_), OPENING)
    assert not graspable_by_part(narrow, upright_pose(narrow), OPENING)


def test_scenes_may_ask_for_it_and_the_default_ones_do_not() -> None:
    config = TableShelfConfig(targets=("025_mug",))
    downs = [make_scene(seed, config).target for seed in range(12)]
    assert {thing.name for thing in downs} == {"025_mug"}
    assert len({tuple(Rotation.from_quat(t.pose[:4], scalar_first=True).as_matrix()[2].round(1)) for t in downs}) > 2
    assert "025_mug" not in {*TableShelfConfig().targets, *TableShelfConfig().clutter}
    with_mug = replace(TableShelfConfig(), clutter=("025_mug",), table_clutter=(1, 1))
    assert any(thing.name == "025_mug" for thing in make_scene(0, with_mug).others)


@pytest.mark.slow
def test_the_expert_brings_it_to_the_shelf_by_friction_alone() -> None:
    # A roof high enough for a gripper that comes from above; by the handle it goes under any.
    config = TableShelfConfig(targets=("025_mug",), shelf_clearance=0.55)
    env = gym.make("regrasp_gym/PandaYCB-v0", scene_config=config)
    expert = regrasp_gym.PlannerExpert(env)
    planned = executed = 0
    for seed in range(4):
        env.reset(seed=seed)
        if not expert.reset():
            continue
        planned += 1
        while (action := expert.act()) is not None:
            *_, info = env.step(action)
        executed += info["is_success"]
    assert planned >= 2
    assert executed == planned
