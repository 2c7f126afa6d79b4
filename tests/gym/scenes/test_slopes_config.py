"""What the config of stones on slopes tunes, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from hulls import hull_distance
from scene_geometry import rotation, world_points
from slope_scenes import top_face

from regrasp_gym.errors import SceneError
from regrasp_gym.scenes.slopes import make_scene
from regrasp_gym.scenes.slopes_config import SlopesConfig

CONFIG = SlopesConfig()


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
