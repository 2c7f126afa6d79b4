"""Scenes of stones on slopes: exact contact, exact clearance and statics."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hulls import hull_distance
from scene_geometry import box_corners, rotation, world_points
from scipy.spatial import ConvexHull
from slope_scenes import SCENES, fixture, top_face

from regrasp_gym.scenes.scene import Scene
from regrasp_gym.scenes.slopes import make_scene
from regrasp_gym.scenes.slopes_config import MAX_OTHERS, SlopesConfig

CONFIG = SlopesConfig()


def support_margin(model, pose, point, normal, extra=()):
    """Margin against tipping: distance from the edge of the contact to the point below the centre of mass.

    ``extra``: (mass, position) of carried loads.
    """
    points = world_points(model, pose)
    height = (points - point) @ normal
    assert height.min() == pytest.approx(0, abs=1e-9), "touches the plane and does not sink in"
    touching = points[height < 1e-7]
    assert len(touching) >= 3
    masses = np.array([model.mass, *(mass for mass, _ in extra)])
    center = masses @ np.array([pose[4:], *(at for _, at in extra)]) / masses.sum()
    foot = center - [0, 0, (center - point) @ normal / normal[2]]
    x = np.cross(normal, [1.0, 0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    flat = touching @ np.column_stack([x, y])
    equations = ConvexHull(flat).equations
    return -(equations[:, :2] @ [foot @ x, foot @ y] + equations[:, 2]).max()


def test_it_is_a_scene() -> None:
    assert all(isinstance(scene, Scene) for scene in SCENES)


def test_same_seed_same_scene_whatever_was_made_in_between() -> None:
    first = make_scene(11)
    make_scene(12)
    make_scene(11, SlopesConfig(on_top=0.0))
    again = make_scene(11)
    np.testing.assert_array_equal(first.goal_pose, again.goal_pose)
    assert first.instruction == again.instruction
    for one, other in zip((first.target, *first.others), (again.target, *again.others), strict=True):
        assert one.name == other.name
        np.testing.assert_array_equal(one.pose, other.pose)
        np.testing.assert_array_equal(one.model.pieces[0], other.model.pieces[0])


def test_different_seeds_differ() -> None:
    assert len({scene.target.pose.tobytes() for scene in SCENES}) == len(SCENES)


def test_every_seed_gives_a_scene_with_enough_stones() -> None:
    short = 0
    for seed in range(100):
        scene = make_scene(seed)
        assert len(scene.others) <= MAX_OTHERS
        for stones, limits in ((scene.pick_stones, CONFIG.pick_stones), (scene.place_stones, CONFIG.place_stones)):
            assert len(stones) <= limits[1]
            short += len(stones) < limits[0]
        names = [thing.name for thing in (scene.target, *scene.others)]
        assert names == ["stone_0", *sorted(set(names[1:]), key=names.index)]
        assert len(set(names)) == len(names)
    assert short <= 1


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: str(scene.seed))
def test_everything_rests_flush_and_stably(scene) -> None:
    for things, name in (((scene.target, *scene.pick_stones), "pick_slope"), (scene.place_stones, "place_slope")):
        point, frame = top_face(scene, name)
        for thing in things:
            margin = support_margin(thing.model, thing.pose, point, frame[:, 2])
            assert margin >= CONFIG.rest_margin - 1e-9
    model, goal = scene.target.model, scene.goal_pose
    point, frame = top_face(scene, "place_slope")
    if scene.base is None:
        assert support_margin(model, goal, point, frame[:, 2]) >= CONFIG.rest_margin - 1e-9
        return
    base = next(thing for thing in scene.place_stones if thing.name == scene.base)
    below, above = world_points(base.model, base.pose), world_points(model, goal)
    # The plane between the two is a facet of both.
    planes = ConvexHull(below).equations
    level = (above @ planes[:, :3].T + planes[:, 3]).min(axis=0)
    plane = planes[level.argmax()]
    assert plane[2] >= np.cos(CONFIG.top_inclination) - 1e-9
    shared = below[np.abs(below @ plane[:3] + plane[3]) < 1e-7]
    assert shared[:, 2].mean() <= CONFIG.top_height + 1e-9
    assert support_margin(model, goal, shared[0], plane[:3]) >= CONFIG.top_margin - 1e-9
    # The point below the load is inside of the base's facet too, and the base carries the load.
    foot = goal[4:] - [0, 0, (goal[4:] - shared[0]) @ plane[:3] / plane[2]]
    spokes = shared - foot
    x = np.cross(plane[:3], [1.0, 0, 0])
    x /= np.linalg.norm(x)
    corners = spokes @ np.column_stack([x, np.cross(plane[:3], x)])
    assert -ConvexHull(corners).equations[:, 2].max() >= CONFIG.top_margin - 1e-9
    load = [(model.mass, goal[4:])]
    assert support_margin(base.model, base.pose, point, frame[:, 2], load) >= CONFIG.top_margin - 1e-9


@pytest.mark.parametrize("scene", SCENES[:25], ids=lambda scene: str(scene.seed))
def test_hulls_keep_apart_exactly(scene) -> None:
    pick = [world_points(thing.model, thing.pose) for thing in (scene.target, *scene.pick_stones)]
    place = {thing.name: world_points(thing.model, thing.pose) for thing in scene.place_stones}
    goal = world_points(scene.target.model, scene.goal_pose)
    for a, b in itertools.combinations(pick, 2):
        assert hull_distance(a, b) > CONFIG.pick_gap[0] - 1e-4
    for a, b in itertools.combinations(place.values(), 2):
        assert hull_distance(a, b) > CONFIG.goal_gap[0] - 1e-4
    for name, points in place.items():
        least = -1e-6 if name == scene.base else CONFIG.goal_gap[0] - 1e-4
        assert hull_distance(goal, points) > least
    for box in scene.fixtures:
        corners = box_corners(box)
        for points in (*pick, *place.values(), goal):
            assert hull_distance(points, corners) > -1e-6, box.name


def test_everything_is_where_the_machine_reaches() -> None:
    for scene in SCENES:
        low = scene.release.center[:2] - scene.release.half_extents
        high = scene.release.center[:2] + scene.release.half_extents
        poses = [(thing.model, thing.pose) for thing in (scene.target, *scene.others)]
        for model, pose in (*poses, (scene.target.model, scene.goal_pose)):
            assert 4.3 < np.linalg.norm(pose[4:6]) < 8.3
            points = world_points(model, pose)
            assert points[:, 2].min() > 0.0
            assert points[:, 2].max() < 3.0
            assert (points[:, :2].max(axis=0) < low).any() or (points[:, :2].min(axis=0) > high).any()
        assert scene.target.pose[5] < -3 < 3 < scene.goal_pose[5]
        for name in ("pick_slope", "place_slope"):
            slope = fixture(scene, name)
            corners = box_corners(slope)
            assert corners[4::2, 2].min() < 0, "sunk into the ground"
            above = corners[corners[:, 2] > 0][:, :2]
            assert ((above.max(axis=0) < low) | (above.min(axis=0) > high)).any()
            inclination = np.arccos(rotation(slope.pose)[2, 2])
            assert CONFIG.inclination[0] - 1e-9 <= inclination <= CONFIG.inclination[1] + 1e-9


def test_targets_fit_the_gripper_as_they_lie() -> None:
    for scene in SCENES:
        poses = [(scene.target.pose, "pick_slope")]
        if scene.base is None:
            poses.append((scene.goal_pose, "place_slope"))
        for pose, name in poses:
            _, frame = top_face(scene, name)
            flat = world_points(scene.target.model, pose) @ frame[:, :2]
            angles = np.linspace(0, np.pi, 1800)
            widths = np.ptp(flat @ np.stack([np.cos(angles), np.sin(angles)]), axis=0)
            assert widths.min() <= CONFIG.max_opening - CONFIG.opening_margin + 1e-3


def test_the_instruction_names_one_stone_each() -> None:
    for scene in SCENES:
        label = scene.target.model.label
        assert scene.instruction.startswith(f"put the {label} on ")
        assert all(thing.model.label != label for thing in scene.others)
        if scene.base is not None:
            below = [
                thing.name for thing in scene.place_stones if f"on the {thing.model.label} on" in scene.instruction
            ]
            assert below == [scene.base]
