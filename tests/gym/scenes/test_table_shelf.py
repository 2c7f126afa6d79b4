"""Scenes of table and shelf: exact contact, exact clearance, and what the config tunes and refuses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hulls import hull_distance
from scene_geometry import box_corners, rotation, world_points

from regrasp_gym.errors import SceneError
from regrasp_gym.scenes.resting import upright_pose
from regrasp_gym.scenes.table_shelf import make_scene
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig

CONFIG = TableShelfConfig()


def assert_same(a, b):
    assert a.target.name == b.target.name
    np.testing.assert_array_equal(a.target.pose, b.target.pose)
    np.testing.assert_array_equal(a.goal_pose, b.goal_pose)
    assert [thing.name for thing in a.others] == [thing.name for thing in b.others]
    for one, other in zip(a.others, b.others, strict=True):
        np.testing.assert_array_equal(one.pose, other.pose)


def test_same_seed_same_scene_whatever_was_made_in_between():
    first = make_scene(11)
    make_scene(12)
    make_scene(11, TableShelfConfig(table_clutter=(1, 1)))
    assert_same(first, make_scene(11))


def test_different_seeds_differ():
    assert len({make_scene(seed).target.pose.tobytes() for seed in range(50)}) == 50


def test_every_seed_gives_a_scene_with_enough_clutter():
    crowded = 0
    for seed in range(600):
        scene = make_scene(seed)
        assert 2 <= len(scene.table_objects) <= CONFIG.table_clutter[1]
        assert CONFIG.shelf_clutter[0] <= len(scene.shelf_objects) <= CONFIG.shelf_clutter[1]
        # Rarely there is no room for the least number on the table.
        crowded += len(scene.table_objects) < CONFIG.table_clutter[0]
        names = [scene.target.name, *(thing.name for thing in scene.others)]
        assert len(set(names)) == len(names)
    assert crowded <= 6


def test_every_target_comes_up():
    assert {make_scene(seed).target.name for seed in range(200)} == set(CONFIG.targets)


@pytest.mark.parametrize("seed", range(25))
def test_hulls_keep_apart_exactly(seed):
    scene = make_scene(seed)
    start = [world_points(thing.model, thing.pose) for thing in (scene.target, *scene.others)]
    for a, b in itertools.combinations(start, 2):
        assert hull_distance(a, b) > CONFIG.pick_gap - 1e-4
    goal = world_points(scene.target.model, scene.goal_pose)
    for thing in scene.shelf_objects:
        assert hull_distance(goal, world_points(thing.model, thing.pose)) > CONFIG.goal_gap - 1e-4
    for fixture in scene.fixtures:
        box = box_corners(fixture)
        for points in (*start, goal):
            assert hull_distance(points, box) > -1e-6, fixture.name


@pytest.mark.parametrize("seed", range(60))
def test_everything_is_where_it_belongs(seed):
    scene = make_scene(seed)
    low = np.array(CONFIG.pick_center) - np.array(CONFIG.pick_size) / 2
    high = np.array(CONFIG.pick_center) + np.array(CONFIG.pick_size) / 2
    for thing in (scene.target, *scene.table_objects):
        points = world_points(thing.model, thing.pose)
        assert (points[:, :2] >= low - 1e-9).all()
        assert (points[:, :2] <= high + 1e-9).all()
        assert points[:, 2].min() == pytest.approx(0, abs=1e-9)
    goal = world_points(scene.target.model, scene.goal_pose)
    assert goal[:, 2].min() == pytest.approx(CONFIG.board_height, abs=1e-9)
    assert goal[:, 2].max() < CONFIG.board_height + CONFIG.shelf_clearance
    up = rotation(scene.goal_pose)[:, 2]
    assert up[2] > np.cos(np.deg2rad(10))
    for pose in (scene.target.pose, scene.goal_pose):
        assert 0.25 < np.linalg.norm(pose[4:6]) < 0.75


def test_release_area_is_free():
    for seed in range(100):
        scene = make_scene(seed)
        low = scene.release.center[:2] - scene.release.half_extents
        high = scene.release.center[:2] + scene.release.half_extents
        for thing in (scene.target, *scene.others):
            points = world_points(thing.model, thing.pose)[:, :2]
            assert (points.max(axis=0) < low).any() or (points.min(axis=0) > high).any()
        for fixture in scene.fixtures[1:]:
            half_diagonal = np.linalg.norm(fixture.size[:2]) / 2
            middle = np.clip(fixture.pose[4:6], low, high)
            assert np.linalg.norm(fixture.pose[4:6] - middle) > 0 or half_diagonal == 0


def test_goal_is_near_the_opening_and_the_opening_faces_the_base():
    for seed in range(60):
        scene = make_scene(seed)
        center = np.array(CONFIG.shelf_center)
        outward = -center / np.linalg.norm(center)
        points = world_points(scene.target.model, scene.goal_pose)[:, :2]
        front = CONFIG.shelf_inside[1] / 2
        to_edge = front - ((points - center) @ outward).max()
        assert CONFIG.goal_depth[0] - 1e-9 <= to_edge <= CONFIG.goal_depth[1] + 1e-9
        back = next(fixture for fixture in scene.fixtures if fixture.name == "shelf_back")
        assert np.linalg.norm(back.pose[4:6]) > np.linalg.norm(center)


def test_goal_has_its_narrow_sides_beside_the_gripper_and_keeps_off_the_walls():
    inward = np.array(CONFIG.shelf_center) / np.linalg.norm(CONFIG.shelf_center)
    across = np.array([-inward[1], inward[0]])
    turns = []
    for seed in range(200):
        scene = make_scene(seed)
        points = world_points(scene.target.model, scene.goal_pose)[:, :2]
        side = (points - np.array(CONFIG.shelf_center)) @ across
        assert np.abs(side).max() <= CONFIG.shelf_inside[0] / 2 - CONFIG.goal_wall_gap + 1e-9
        # Some level direction near the opening's is as narrow as the target gets.
        angles = np.linspace(-CONFIG.goal_yaw, CONFIG.goal_yaw, 401)
        fan = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * inward
        widths = np.ptp(points @ fan.T, axis=0)
        upright = upright_pose(scene.target.model)
        assert upright is not None
        assert widths.min() == pytest.approx(upright.level_width, abs=2e-4)
        if scene.target.name == "003_cracker_box":
            turns.append(angles[widths.argmin()])
    assert min(turns) < -0.2
    assert max(turns) > 0.2


def test_the_shelf_does_not_depend_on_the_table():
    for seed in range(20):
        one, other = make_scene(seed), make_scene(seed, TableShelfConfig(pick_gap=0.03))
        assert one.target.name == other.target.name
        np.testing.assert_array_equal(one.goal_pose, other.goal_pose)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"targets": ("004_sugarbox",)}, "004_sugarbox"),
        ({"targets": ()}, "targets is empty"),
        ({"table_clutter": (3, 1)}, "table_clutter"),
        ({"max_opening": 0.05}, "the gripper takes at most 46 mm"),
    ],
)
def test_bad_configurations_are_refused_by_name(changes, message):
    with pytest.raises(SceneError, match=message):
        TableShelfConfig(**changes)


def test_negative_seed_is_refused():
    with pytest.raises(SceneError, match="-1"):
        make_scene(-1)


def test_a_board_too_small_is_refused():
    config = TableShelfConfig(targets=("003_cracker_box",), shelf_inside=(0.1, 0.05))
    with pytest.raises(SceneError, match="shelf"):
        make_scene(0, config)
