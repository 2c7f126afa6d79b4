"""The pictures of README and docs: what they are put together from, and that they show what they say."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_bench.pictures import studio
from regrasp_bench.pictures.basins import basins_picture
from regrasp_bench.pictures.command import PicturesOptions, pictures
from regrasp_bench.pictures.execution import execution_picture
from regrasp_bench.pictures.poses import poses_picture
from regrasp_bench.pictures.union import _cut, gripper_looks, union_picture
from regrasp_gym.errors import EnvError, OptionError
from regrasp_gym.expert.plan_picture import release_tilt
from regrasp_gym.objects.shapes import box
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.rendering.surfaces import faceted
from regrasp_gym.robots.panda import PANDA
from regrasp_gym.scenes.scene import Fixture
from regrasp_planner import Grasp, Stage, StageKind

CAMERA = Camera("c", (0.8, -1.0, 0.7), (0.0, 0.0, 0.1), 40.0)


def test_what_is_put_somewhere_is_seen_there() -> None:
    room = studio.Studio()
    places = {(0.9, 0.1, 0.1, 1.0): (0.2, 0.1, 0.05), (0.1, 0.2, 0.9, 1.0): (-0.15, -0.1, 0.2)}
    for colour, place in places.items():
        room.add(faceted(box(0.06, 0.06, 0.06)), np.array([1.0, 0, 0, 0, *place]), colour)
    picture = room.picture(CAMERA, 240, 320)
    assert picture.shape == (240, 320, 3)
    pixels = studio.to_pixels(CAMERA, np.array(list(places.values())), 240, 320)
    for colour, (column, row) in zip(places, pixels, strict=True):
        seen = picture[round(row), round(column)].astype(int)
        assert seen.argmax() == np.argmax(colour[:3])
        assert seen.max() > 2 * seen.min()
    assert (picture[0, 0] > 235).all(), "the rest is white"


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_arrows_point_where_they_should(vector: list[float]) -> None:
    direction = np.array(vector) / np.linalg.norm(vector)
    pose = studio.pose_along(direction, np.array([1.0, 2.0, 3.0]))
    turn = Rotation.from_quat(pose[:4], scalar_first=True)
    assert turn.apply([0, 0, 1]) == pytest.approx(direction, abs=1e-6)
    assert pose[4:].tolist() == [1, 2, 3]


def test_an_arrow_straight_down() -> None:
    pose = studio.pose_along(np.array([0.0, 0.0, -1.0]), np.zeros(3))
    assert Rotation.from_quat(pose[:4], scalar_first=True).apply([0, 0, 1]) == pytest.approx([0, 0, -1])


def test_cones_and_arrows_have_the_size_asked_for() -> None:
    made = studio.cone(0.4, 0.2).vertices
    length = np.linalg.norm(made, axis=1)
    lean = np.arccos(np.clip(made[length > 0.1, 2] / length[length > 0.1], -1, 1))
    assert length.max() == pytest.approx(0.2)
    assert lean.max() == pytest.approx(0.4)
    assert np.ptp(studio.arrow(0.3, 0.004).vertices, axis=0) == pytest.approx([0.024, 0.024, 0.3])


def test_sheets_captions_and_margins() -> None:
    dark = np.full((20, 30, 3), 10, np.uint8)
    sheet = studio.side_by_side([dark] * 3, 2, gap=4)
    assert sheet.shape == (44, 64, 3)
    assert (sheet[20:24] == 255).all()
    assert (sheet[24:, 34:] == 255).all(), "the last place is empty"
    named = studio.captioned(dark, "(a) dark", 10)
    assert named.shape == (40, 30, 3)
    assert (named[:20] == dark).all()
    assert (named[20:] < 100).any()
    assert studio.cropped(sheet, margin=0).shape == sheet.shape
    framed = np.full((50, 60, 3), 255, np.uint8)
    framed[10:30, 20:50] = dark
    assert studio.cropped(framed, margin=5).shape == (30, 40, 3)


def test_files_are_small_and_hold_the_picture(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    smooth = np.asarray(Image.fromarray(rng.integers(0, 255, (6, 8, 3), np.uint8)).resize((400, 300)))
    studio.save(smooth, tmp_path / "new" / "smooth.png")
    stored = np.asarray(Image.open(tmp_path / "new" / "smooth.png").convert("RGB"))
    assert np.abs(stored.astype(int) - smooth).mean() < 10
    assert os.path.getsize(tmp_path / "new" / "smooth.png") < 120_000


def test_the_gripper_is_drawn_as_it_stands() -> None:
    gripper = PANDA.planner_robot().gripper
    for theta in (0.0, 0.02, 0.04):
        points = np.concatenate([look.vertices for look in gripper_looks(PANDA, theta)])
        # The pads, about the grasp centre: their faces are 2θ apart.
        assert np.abs(points[points[:, 2] > -0.01, 1]).min() == pytest.approx(theta, abs=1.5e-3)
        # All of it lies about the planner's bodies.
        low = min(gripper.palm[k].hull_vertices()[:, 2].min() for k in range(gripper.palm.batch_size))
        assert points[:, 2].min() == pytest.approx(low, abs=0.01)


def test_supports_are_cut_to_what_is_near() -> None:
    table = Fixture("table", np.array([2.0, 2.0, 0.04]), np.array([1.0, 0, 0, 0, 0, 0, -0.02]), "table")
    cut = _cut(table, np.array([0.3, 0.2, 0.05]))
    assert cut is not None
    assert ConvexHull(cut.vertices).volume == pytest.approx(np.pi * 0.24**2 * 0.04, rel=0.01)
    assert cut.vertices[:, :2].mean(axis=0) == pytest.approx([0.3, 0.2], abs=0.01)
    assert _cut(replace(table, pose=np.array([1.0, 0, 0, 0, 3.0, 0, 0])), np.zeros(3)) is None


def test_tilt_is_the_angle_to_the_ground_and_no_turn_about_the_vertical() -> None:
    settled = np.array([1.0, 0, 0, 0, 0, 0, 0])
    for turn, expected in ((Rotation.from_euler("z", 1.0), 0.0), (Rotation.from_euler("zx", [1.0, 0.3]), 0.3)):
        release = np.append(turn.as_quat(scalar_first=True), np.zeros(3))
        grasp = Grasp(settled, 0.01, 0.02, 2.0, 0.01)
        stage = Stage(StageKind.PICK_TO_RELEASE, grasp, settled, release, settled, ())
        assert release_tilt(stage) == pytest.approx(expected, abs=1e-6)


def colours(picture: np.ndarray) -> int:
    """Number of hues, in steps of 30°, that cover at least a thousandth of the picture."""
    hsv = np.asarray(Image.fromarray(picture).convert("HSV")).reshape(-1, 3)
    strong = hsv[(hsv[:, 1] > 90) & (hsv[:, 2] > 60), 0]
    return int((np.bincount(strong // 22, minlength=12) > 0.001 * len(hsv)).sum())


def test_basins_come_in_their_colours() -> None:
    picture = basins_picture(size=150)
    left, middle, right = np.array_split(picture, 3, axis=1)
    assert min(colours(part) for part in (left, middle, right)) >= 3
    np.testing.assert_array_equal(basins_picture(size=150), picture)


def test_stable_poses_of_objects_are_drawn_each_in_its_place() -> None:
    one = poses_picture(("061_foam_brick",), rows=1, height=200, width=300)
    three = poses_picture(("061_foam_brick", "025_mug"), rows=3, height=300, width=500)
    assert three.shape[0] > one.shape[0]
    assert three.shape[1] > one.shape[1]
    assert colours(three) >= 3


def test_the_command_writes_files_and_refuses_unknown_objects(tmp_path: Path) -> None:
    assert pictures(PicturesOptions(("basins",), tmp_path, thing="061_foam_brick")) == 0
    assert [file.name for file in tmp_path.iterdir()] == ["basins.png"]
    assert os.path.getsize(tmp_path / "basins.png") < 300_000
    with pytest.raises(OptionError, match=r"unknown object 'teapot'.*025_mug"):
        pictures(PicturesOptions(("basins",), tmp_path, thing="teapot"))


@pytest.mark.slow
def test_the_union_shows_both_scenes_and_a_gripper() -> None:
    picture = union_picture(size=160)
    pick, place, both = np.array_split(picture, 3, axis=1)

    def share(part: np.ndarray, low: int, high: int) -> float:
        hsv = np.asarray(Image.fromarray(part).convert("HSV")).reshape(-1, 3)
        return float(((hsv[:, 0] >= low) & (hsv[:, 0] <= high) & (hsv[:, 1] > 40)).mean())

    magenta, cyan, green = (205, 240), (115, 150), (70, 114)
    assert share(pick, *magenta) > 0.1 > 0.01 > share(pick, *cyan)
    assert share(place, *cyan) > 0.1 > 0.01 > share(place, *magenta)
    assert share(both, *magenta) > 0.02
    assert share(both, *cyan) > 0.02
    assert share(pick, *green) > 0.01


@pytest.mark.slow
def test_the_execution_of_a_regrasp_has_eight_different_moments() -> None:
    for seed in range(20):
        try:
            picture = execution_picture(seed=seed, height=120, width=144)
            break
        except EnvError:
            continue
    else:
        pytest.fail("no scene of twenty with a regrasp that succeeds")
    assert picture.shape == (2 * (120 + 32) + 6, 4 * 144 + 3 * 6, 3)
    moments = [
        picture[top : top + 120, left : left + 144].astype(int) for top in (0, 158) for left in (0, 150, 300, 450)
    ]
    for k, one in enumerate(moments):
        for other in moments[:k]:
            assert np.abs(one - other).mean() > 1
