"""Random stones: limits, reproducibility, exact facets, and looks that stay inside."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from regrasp_gym.errors import SceneError
from regrasp_gym.geometry.facets import find_facets
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.objects.stone_looks import TONES
from regrasp_gym.objects.stones import KINDS, StoneConfig, stone
from regrasp_gym.scenes.resting import least_width

SEEDS = range(80)


@pytest.fixture(scope="module")
def heap() -> list[ObjectModel]:
    return [stone(seed) for seed in SEEDS]


def extent(model: ObjectModel) -> float:
    points = model.pieces[0]
    return np.linalg.norm(points[:, None] - points, axis=2).max()


def test_same_seed_same_stone() -> None:
    one, other = stone(5), stone(5, name="again", tone="sandy")
    np.testing.assert_array_equal(one.pieces[0], other.pieces[0])
    np.testing.assert_array_equal(one.inertia, other.inertia)
    np.testing.assert_array_equal(one.looks[0].vertices, other.looks[0].vertices)
    assert one.mass == other.mass
    assert (other.name, other.label) == ("again", "sandy stone")


def test_no_two_are_alike(heap: list[ObjectModel]) -> None:
    assert len({thing.pieces[0].tobytes() for thing in heap}) == len(heap)
    assert len({thing.rgba for thing in heap}) == len(heap)
    assert {thing.label for thing in heap} == {f"{tone} stone" for tone in TONES}


def test_stones_keep_to_the_limits(heap: list[ObjectModel]) -> None:
    limits = StoneConfig()
    for thing in heap:
        (points,) = thing.pieces
        hull = ConvexHull(points)
        assert 12 <= len(points) <= 60
        assert len(hull.vertices) == len(points), "every point is a corner"
        assert limits.mass[0] <= thing.mass <= limits.mass[1]
        assert thing.mass == pytest.approx(limits.density * hull.volume)
        assert limits.least_width[0] - 1e-9 <= least_width(thing) <= limits.least_width[1] + 1e-9
        assert extent(thing) <= limits.largest_extent


def test_shapes_vary(heap: list[ObjectModel]) -> None:
    slenderness = np.array([extent(thing) / least_width(thing) for thing in heap])
    assert slenderness.min() < 1.5
    assert slenderness.max() > 2.5
    masses = [thing.mass for thing in heap]
    assert min(masses) < 250
    assert max(masses) > 850


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_made(kind: str) -> None:
    config = StoneConfig(kinds=(kind,))
    width = np.mean([least_width(stone(seed, config)) / extent(stone(seed, config)) for seed in range(12)])
    assert (width < 0.5) == (kind == "slab")


def test_mass_properties_are_those_of_the_solid(heap: list[ObjectModel]) -> None:
    for thing in heap[:20]:
        mesh = trimesh.convex.convex_hull(thing.pieces[0])
        mesh.density = thing.mass / mesh.volume
        assert mesh.center_mass == pytest.approx(np.zeros(3), abs=1e-9)
        assert thing.inertia == pytest.approx(mesh.moment_inertia, rel=1e-6, abs=1e-6)


def test_stones_have_facets_to_rest_on(heap: list[ObjectModel]) -> None:
    for thing in heap:
        facets = find_facets(thing.pieces[0])
        assert ((facets.margins > 0.03) & (facets.areas > 0.02)).sum() >= 2


def test_looks_are_closed_rough_and_never_outside(heap: list[ObjectModel]) -> None:
    for thing in heap[:20]:
        (look,) = thing.looks
        hull = ConvexHull(thing.pieces[0])
        outside = (look.vertices @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        assert outside.max() <= 1e-9
        assert outside.min() > -0.03
        assert outside.std() > 0.001
        mesh = trimesh.Trimesh(look.vertices, look.faces)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        assert mesh.is_watertight
        assert mesh.volume > 0.85 * hull.volume, "turned outwards, and not much smaller"
        assert np.linalg.norm(look.normals, axis=1) == pytest.approx(1)
        assert look.texcoords is not None
        assert look.texcoords.min() >= 0
        assert look.texcoords.max() <= 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kinds": ("pebble",)}, "kinds"),
        ({"kinds": ()}, "kinds"),
        ({"mass": (300.0, 100.0)}, "mass"),
        ({"density": 0.0}, "density"),
        ({"least_width": (-0.1, 0.5)}, "least_width"),
    ],
)
def test_bad_configurations_are_refused_by_name(changes: dict, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        StoneConfig(**changes)


def test_impossible_stones_are_refused() -> None:
    with pytest.raises(SceneError, match=r"largest extent of at most 0\.3"):
        stone(0, StoneConfig(largest_extent=0.3))
    with pytest.raises(SceneError, match="-1"):
        stone(-1)
    with pytest.raises(SceneError, match="pink"):
        stone(0, tone="pink")
