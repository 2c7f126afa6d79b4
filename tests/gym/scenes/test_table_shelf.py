from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from hulls import hull_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_gym.errors import SceneError
from regrasp_gym.objects.model import solid
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.resting import MIN_MARGIN, least_width, resting_poses, upright_pose
from regrasp_gym.scenes.table_shelf import make_scene
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig, check_target

CONFIG = TableShelfConfig()


def world_vertices(model, pose):
    turn = Rotation.from_quat(np.roll(pose[:4], -1)).as_matrix()
    return np.concatenate(model.pieces) @ turn.T + pose[4:]


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
    start = [world_vertices(thing.model, thing.pose) for thing in (scene.target, *scene.others)]
    for a, b in itertools.combinations(start, 2):
        assert hull_distance(a, b) > CONFIG.pick_gap - 1e-4
    goal = world_vertices(scene.target.model, scene.goal_pose)
    for thing in scene.shelf_objects:
        assert hull_distance(goal, world_vertices(thing.model, thing.pose)) > CONFIG.goal_gap - 1e-4
    for fixture in scene.fixtures:
        half = np.array(list(itertools.product((-1, 1), repeat=3))) * fixture.size / 2
        turn = Rotation.from_quat(np.roll(fixture.pose[:4], -1)).as_matrix()
        box = half @ turn.T + fixture.pose[4:]
        for points in (*start, goal):
            assert hull_distance(points, box) > -1e-6, fixture.name


@pytest.mark.parametrize("seed", range(60))
def test_everything_is_where_it_belongs(seed):
    scene = make_scene(seed)
    low = np.array(CONFIG.pick_center) - np.array(CONFIG.pick_size) / 2
    high = np.array(CONFIG.pick_center) + np.array(CONFIG.pick_size) / 2
    for thing in (scene.target, *scene.table_objects):
        points = world_vertices(thing.model, thing.pose)
        assert (points[:, :2] >= low - 1e-9).all()
        assert (points[:, :2] <= high + 1e-9).all()
        assert points[:, 2].min() == pytest.approx(0, abs=1e-9)
    goal = world_vertices(scene.target.model, scene.goal_pose)
    assert goal[:, 2].min() == pytest.approx(CONFIG.board_height, abs=1e-9)
    assert goal[:, 2].max() < CONFIG.board_height + CONFIG.shelf_clearance
    up = Rotation.from_quat(np.roll(scene.goal_pose[:4], -1)).as_matrix()[:, 2]
    assert up[2] > np.cos(np.deg2rad(10))
    for pose in (scene.target.pose, scene.goal_pose):
        assert 0.25 < np.linalg.norm(pose[4:6]) < 0.75


def test_release_area_is_free():
    for seed in range(100):
        scene = make_scene(seed)
        low = scene.release.center[:2] - scene.release.half_extents
        high = scene.release.center[:2] + scene.release.half_extents
        for thing in (scene.target, *scene.others):
            points = world_vertices(thing.model, thing.pose)[:, :2]
            assert (points.max(axis=0) < low).any() or (points.min(axis=0) > high).any()
        for fixture in scene.fixtures[1:]:
            reach = np.linalg.norm(fixture.size[:2]) / 2
            middle = np.clip(fixture.pose[4:6], low, high)
            assert np.linalg.norm(fixture.pose[4:6] - middle) > 0 or reach == 0


def test_goal_is_near_the_opening_and_the_opening_faces_the_base():
    for seed in range(60):
        scene = make_scene(seed)
        center = np.array(CONFIG.shelf_center)
        outward = -center / np.linalg.norm(center)
        points = world_vertices(scene.target.model, scene.goal_pose)[:, :2]
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
        points = world_vertices(scene.target.model, scene.goal_pose)[:, :2]
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


# Resting poses ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", OBJECTS)
def test_resting_poses_rest(name):
    model = OBJECTS[name]
    poses = resting_poses(model)
    assert sum(pose.probability for pose in poses) == pytest.approx(1)
    for pose in poses:
        points = np.concatenate(model.pieces) @ pose.rotation.T
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(pose.rotation @ pose.down, [0, 0, -1], atol=1e-9)
        assert points[:, 2].min() == pytest.approx(-pose.height, abs=1e-12)
        support = points[points[:, 2] < -pose.height + 1e-6][:, :2]
        equations = ConvexHull(support).equations
        assert -equations[:, 2].max() == pytest.approx(pose.margin, abs=1e-9)
        assert pose.margin > 0


@pytest.mark.parametrize("name", ["003_cracker_box", "006_mustard_bottle", "010_potted_meat_can", "065-a_cups"])
def test_landing_probabilities_agree_with_trimesh(name):
    model = OBJECTS[name]
    hull = trimesh.convex.convex_hull(np.concatenate(model.pieces))
    transforms, chances = trimesh.poses.compute_stable_poses(
        hull, center_mass=np.zeros(3), sigma=0, n_samples=1, threshold=0
    )
    ours = resting_poses(model)
    downs = np.array([transform[:3, :3].T @ [0, 0, -1] for transform in transforms])
    # Ours leave out poses with next to no margin; trimesh does not.
    theirs = np.array([chances[downs @ pose.down > np.cos(np.deg2rad(1))].sum() for pose in ours])
    assert theirs.sum() > 0.9
    np.testing.assert_allclose([pose.probability for pose in ours], theirs / theirs.sum(), atol=0.005)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(6, 30))
def test_resting_poses_of_random_hulls(seed, count):
    rng = np.random.default_rng(seed)
    model = solid(f"stone_{seed}_{count}", "stone", 1.0, [rng.normal(size=(count, 3)) * [0.05, 0.04, 0.03]])
    poses = resting_poses(model)
    assert sum(pose.probability for pose in poses) == pytest.approx(1)
    offsets = -ConvexHull(np.concatenate(model.pieces)).equations[:, 3]
    for pose in poses:
        assert np.abs(offsets - pose.height).min() < 1e-9
    # The facet nearest to the centre of mass is always one to rest on, and left out only if its margin is small.
    hull = ConvexHull(np.concatenate(model.pieces))
    facet = hull.points[hull.simplices[offsets.argmin()]]
    normal = hull.equations[offsets.argmin(), :3]
    edges = np.roll(facet, -1, axis=0) - facet
    margin = np.abs(np.einsum("ij,ij->i", np.cross(normal, edges), facet)) / np.linalg.norm(edges, axis=1)
    kept = min(pose.height for pose in poses) == pytest.approx(offsets.min())
    assert kept or margin.min() < MIN_MARGIN


def test_upright_is_upright():
    for name in CONFIG.targets:
        pose = upright_pose(OBJECTS[name])
        assert pose is not None
        assert pose.rotation[2, 2] > np.cos(np.deg2rad(10))
    leaning = Rotation.from_euler("x", 30, degrees=True).apply(OBJECTS["003_cracker_box"].pieces[0])
    model = solid("leaning_box", "leaning box", 0.4, [leaning])
    assert upright_pose(model) is None
    with pytest.raises(SceneError, match=r"leaning_box.*does not stand upright"):
        check_target(model, CONFIG)


def test_least_width_of_a_box_is_its_shortest_edge():
    assert least_width(OBJECTS["009_gelatin_box"]) == pytest.approx(0.03)
