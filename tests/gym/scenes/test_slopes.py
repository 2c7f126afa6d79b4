"""Scenes of stones on slopes: exact contact, exact clearance, statics, stillness in MuJoCo, and pictures."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest
from hulls import hull_distance
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_gym.errors import SceneError
from regrasp_gym.objects.stones import StoneConfig, stone
from regrasp_gym.rendering.materials import MATERIALS
from regrasp_gym.rendering.renderer import SceneRenderer
from regrasp_gym.rendering.setting import SITE, TABLE_TOP, Camera, add_visuals
from regrasp_gym.scenes.scene import PlacedObject, Scene
from regrasp_gym.scenes.slope_resting import SHORTEST_EDGE, seats
from regrasp_gym.scenes.slopes import make_scene
from regrasp_gym.scenes.slopes_config import MAX_OTHERS, SlopesConfig
from regrasp_gym.simulation import physics
from regrasp_gym.simulation.world import add_fixture

CONFIG = SlopesConfig()
SCENES = [make_scene(seed) for seed in range(60)]


def rotation(pose):
    return Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()


def world_points(model, pose):
    return model.pieces[0] @ rotation(pose).T + pose[4:]


def fixture(scene, name):
    return next(f for f in scene.fixtures if f.name == name)


def top_face(scene, name):
    """A point of a slope's surface and its frame."""
    slope = fixture(scene, name)
    frame = rotation(slope.pose)
    return slope.pose[4:] + frame[:, 2] * slope.size[2] / 2, frame


def support_margin(model, pose, point, normal, extra=()):
    """Distance inside of the edge of what touches the plane of where gravity through the mass meets it.

    ``extra``: (mass, position) of loads carried.
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
    # Where the load meets the base is inside of the base's facet too, and the base carries it.
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
        corners = np.array(list(itertools.product((-1, 1), repeat=3))) * box.size / 2
        corners = corners @ rotation(box.pose).T + box.pose[4:]
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
            corners = np.array(list(itertools.product((-1, 1), repeat=3))) * slope.size / 2
            corners = corners @ rotation(slope.pose).T + slope.pose[4:]
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


# What the config tunes ----------------------------------------------------------------------------------------------


def test_shares_follow_the_config() -> None:
    scenes = [make_scene(seed) for seed in range(100)]
    top = np.mean([scene.base is not None for scene in scenes])
    same = np.mean([scene.same_side for scene in scenes])
    # Four standard deviations of a share of 0.3 out of 100.
    assert top == pytest.approx(CONFIG.on_top, abs=0.19)
    assert same == pytest.approx(CONFIG.same_side, abs=0.19)
    for share in (0.0, 1.0):
        some = [make_scene(seed, SlopesConfig(on_top=share, same_side=share)) for seed in range(20)]
        assert np.mean([scene.base is not None for scene in some]) == pytest.approx(share, abs=0.1)
        assert np.mean([scene.same_side for scene in some]) == pytest.approx(share, abs=0.1)


def test_same_side_means_the_same_facet_down_and_goal_yaw_the_turn_seen_from_the_machine() -> None:
    config = SlopesConfig(on_top=0.0, same_side=1.0, goal_yaw=(0.2, 0.5))
    turns = []
    for seed in range(40):
        scene = make_scene(seed, config)
        start, goal = rotation(scene.target.pose), rotation(scene.goal_pose)
        frames = [top_face(scene, name)[1] for name in ("pick_slope", "place_slope")]
        for name, frame in zip(("pick_slope", "place_slope"), frames, strict=True):
            point = top_face(scene, name)[0]
            outward = np.array([point[0], point[1], 0.0])
            assert np.cross(outward, frame[:, 0])[2] == pytest.approx(0, abs=2.0)
            assert frame[:, 0] @ outward > 0
            assert frame[:, 1] @ outward == pytest.approx(0, abs=1e-9)
        turned = (frames[1].T @ goal) @ (frames[0].T @ start).T
        assert turned[2, 2] == pytest.approx(1)
        turns.append(np.arctan2(turned[1, 0], turned[0, 0]))
    assert np.abs(turns).min() >= 0.2 - 1e-6
    assert np.abs(turns).max() <= 0.5 + 1e-6
    assert min(turns) < 0 < max(turns)


def test_another_side_is_another_facet() -> None:
    config = SlopesConfig(same_side=0.0, on_top=0.0, goal_yaw=(0.0, 0.0))
    for seed in range(30):
        scene = make_scene(seed, config)
        downs = [
            -rotation(pose).T @ top_face(scene, name)[1][:, 2]
            for pose, name in ((scene.target.pose, "pick_slope"), (scene.goal_pose, "place_slope"))
        ]
        assert (downs[0] @ downs[1] < 0.999) == (not scene.same_side)
        # Without a turn the stone is only rolled, by the angle between the two facets.
        frames = [top_face(scene, name)[1] for name in ("pick_slope", "place_slope")]
        rolled = (frames[1].T @ rotation(scene.goal_pose)) @ (frames[0].T @ rotation(scene.target.pose)).T
        angle = np.arccos(np.clip((np.trace(rolled) - 1) / 2, -1, 1))
        assert angle == pytest.approx(np.arccos(np.clip(downs[0] @ downs[1], -1, 1)), abs=1e-5)


def test_smaller_gaps_bring_the_neighbours_nearer() -> None:
    def nearest(gap):
        found = []
        for seed in range(15):
            scene = make_scene(seed, SlopesConfig(pick_gap=gap, pick_stones=(3, 3)))
            target = world_points(scene.target.model, scene.target.pose)
            found.append(
                min(hull_distance(target, world_points(thing.model, thing.pose)) for thing in scene.pick_stones)
            )
        return np.median(found)

    assert nearest((0.05, 0.05)) < 0.3 < 0.5 < nearest((0.5, 0.5))


def test_one_slope_does_not_change_the_other() -> None:
    for seed in range(10):
        one, other = make_scene(seed), make_scene(seed, SlopesConfig(pick_gap=(0.3, 0.3)))
        np.testing.assert_array_equal(one.goal_pose, other.goal_pose)
        assert [thing.pose.tobytes() for thing in one.place_stones] == [t.pose.tobytes() for t in other.place_stones]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pick_stones": (3, 1)}, "pick_stones"),
        ({"pick_stones": (2, 6)}, "more than 10 together"),
        ({"goal_gap": (-0.1, 0.1)}, "goal_gap"),
        ({"on_top": 1.5}, "on_top"),
        ({"place_stones": (0, 2)}, "place_stones"),
        ({"inclination": (0.1, 0.6)}, "inclination is up to 0.60"),
        ({"top_inclination": 0.7}, "top_inclination"),
    ],
)
def test_bad_configurations_are_refused_by_name(changes, message) -> None:
    with pytest.raises(SceneError, match=message):
        SlopesConfig(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"max_opening": 0.4}, "max_opening"),
        ({"rest_margin": 0.7}, "rest_margin"),
        ({"slope_radius": 0.15, "target_spread": 0.0, "goal_spread": 0.0}, "slope_radius"),
    ],
)
def test_impossible_configurations_are_refused_by_name(changes, message) -> None:
    with pytest.raises(SceneError, match=message):
        make_scene(0, SlopesConfig(**changes))


def test_negative_seed_is_refused() -> None:
    with pytest.raises(SceneError, match="-1"):
        make_scene(-1)


# Geometry -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_seats_rest_and_tip_where_statics_says(seed) -> None:
    model = stone(seed)
    fall = np.array([0.2, 0.1])
    for seat in seats(model):
        placed = model.pieces[0] @ seat.rotation.T
        assert placed[:, 2].min() == pytest.approx(-seat.height)
        touching = placed[placed[:, 2] < -seat.height + 1e-7][:, :2]
        assert {tuple(p) for p in touching.round(6) + 0.0} == {tuple(p) for p in seat.corners.round(6) + 0.0}
        edges = np.linalg.norm(seat.corners - np.roll(seat.corners, 1, axis=0), axis=1)
        assert edges.min() >= SHORTEST_EDGE
        for yaw in (0.0, 1.0, -2.5):
            c, s = np.cos(yaw), np.sin(yaw)
            equations = ConvexHull(touching @ np.array([[c, s], [-s, c]])).equations
            expected = -(equations[:, :2] @ (seat.height * fall) + equations[:, 2]).max()
            assert seat.margin(np.array([yaw]), fall)[0] == pytest.approx(expected)


# Physics and pictures -----------------------------------------------------------------------------------------------


def compiled(scene, target_pose, cameras=()):
    spec = mujoco.MjSpec()
    physics.configure(spec)
    add_visuals(spec, cameras, -0.05, SITE)
    for box in scene.fixtures:
        add_fixture(spec, box)
    for thing in (PlacedObject(scene.target.model, target_pose), *scene.others):
        thing.model.add_to(spec, thing.name, thing.pose)
    model = spec.compile()
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("scene", SCENES[:12], ids=lambda scene: str(scene.seed))
@pytest.mark.parametrize("at_goal", [False, True], ids=["start", "goal"])
def test_nothing_moves(scene, at_goal) -> None:
    model, data = compiled(scene, scene.goal_pose if at_goal else scene.target.pose)
    start = data.qpos.reshape(-1, 7).copy()
    mujoco.mj_step(model, data, 900)
    middle = data.qpos.reshape(-1, 7).copy()
    fastest = np.zeros(len(start))
    for _ in range(100):
        mujoco.mj_step(model, data)
        fastest = np.maximum(fastest, np.linalg.norm(data.qvel.reshape(-1, 6)[:, :3], axis=1))
    end = data.qpos.reshape(-1, 7)
    assert np.linalg.norm(end[:, :3] - start[:, :3], axis=1).max() < 2e-3
    turned = 2 * np.arccos(np.clip(np.abs((end[:, 3:] * start[:, 3:]).sum(axis=1)), 0, 1))
    assert np.degrees(turned).max() < 0.2
    assert np.linalg.norm(end[:, :3] - middle[:, :3], axis=1).max() / 0.2 < 1e-3
    # Where MuJoCo changes the corners that it holds a facet by, a stone trembles.
    assert np.median(fastest) < 1e-3
    assert fastest.max() < 1e-2


def test_stones_are_seen_on_the_slopes() -> None:
    camera = Camera("site", (-4.0, -14.0, 8.0), (5.0, 0.0, 0.5))
    renderer = SceneRenderer(256, 192)
    for scene in SCENES[:3]:
        model, data = compiled(scene, scene.target.pose, [camera])
        mujoco.mj_forward(model, data)
        before = renderer.render(model, data, "site", 256, 192).astype(int)
        assert before.std() > 15
        seen = 0
        for thing in (scene.target, *scene.others):
            address = model.joint(f"{thing.name}_joint").qposadr[0]
            saved = data.qpos.copy()
            data.qpos[address + 2] = -50
            mujoco.mj_forward(model, data)
            after = renderer.render(model, data, "site", 256, 192).astype(int)
            seen += (np.abs(after - before).max(axis=2) > 12).sum() >= 6
            data.qpos[:] = saved
        assert seen >= len(scene.others), "one may hide behind another"
    renderer.close()


def test_every_setting_has_its_materials() -> None:
    for setting in (TABLE_TOP, SITE):
        assert {setting.floor, *setting.materials} <= set(MATERIALS)
        assert setting.floor in setting.materials
    assert {box.material for box in SCENES[0].fixtures} <= set(SITE.materials)
    for config in (StoneConfig(), SlopesConfig().base):
        assert config.mass[1] <= 1000
