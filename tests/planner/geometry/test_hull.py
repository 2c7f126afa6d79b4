"""Exact hulls: facets, mass properties, width; trimesh and closed forms as oracles."""

import numpy as np
import pytest
import trimesh

from regrasp_planner import GeometryError
from regrasp_planner.geometry import facets, mass_properties, minimal_width, qhull
from regrasp_planner.geometry.hull import clip_lines, hull_planes

CUBE = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)


@pytest.mark.parametrize("seed", range(5))
def test_mass_properties_match_trimesh(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, 3)) * [0.02, 0.03, 0.05] + rng.normal(size=3)
    mesh = trimesh.Trimesh(points).convex_hull
    found = mass_properties(points)
    assert found.volume == pytest.approx(mesh.volume, rel=1e-9)
    np.testing.assert_allclose(found.center, mesh.center_mass, rtol=1e-9)
    np.testing.assert_allclose(found.inertia, mesh.moment_inertia / mesh.mass, rtol=1e-6, atol=1e-9)


def test_coplanar_triangles_are_merged_and_margins_exact():
    found = facets(qhull(CUBE * [0.03, 0.02, 0.01]), np.array([0.005, 0.0, 0.0]))
    assert len(found.normals) == 6
    assert len(found.edges) == 12
    up = found.normals[:, 2] > 0.9
    assert found.heights[up] == pytest.approx(0.01)
    assert found.margins[up] == pytest.approx(0.02)
    ahead = found.normals[:, 0] > 0.9
    assert found.heights[ahead] == pytest.approx(0.025)
    assert found.margins[ahead] == pytest.approx(0.01)


def test_a_leaning_solid_topples_over_the_edge_it_overhangs():
    lower = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float)
    found = facets(qhull(np.vstack([lower, lower + np.array([3.0, 0, 1])])), np.array([2.0, 0.5, 0.5]))
    bottom = int((found.normals @ [0, 0, -1]).argmax())
    assert found.margins[bottom] == pytest.approx(-1.0)
    assert found.normals[found.topples_to[bottom]] == pytest.approx([np.sqrt(0.1), 0, -3 * np.sqrt(0.1)])


def test_rolling_over_an_edge_lifts_the_centre_to_the_edge_distance():
    found = facets(qhull(CUBE), np.zeros(3))
    np.testing.assert_allclose(found.passes, np.sqrt(2))


def test_minimal_width():
    assert minimal_width(CUBE * [0.5, 0.3, 0.2]) == pytest.approx(0.4)
    # The width of a regular tetrahedron of edge a is a/√2, between two opposite edges.
    tetrahedron = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)
    assert minimal_width(tetrahedron) == pytest.approx(2.0)


def test_flat_points_are_refused():
    with pytest.raises(GeometryError, match="zero volume"):
        qhull(np.random.default_rng(0).normal(size=(30, 3)) @ np.diag([1.0, 1.0, 0.0]))


@pytest.mark.parametrize("seed", range(4))
def test_lines_are_clipped_by_a_hull_where_they_pierce_it(seed):
    """Just inside of both ends a point is in the hull, just outside it is not; lines that miss say so."""
    rng = np.random.default_rng(seed)
    hull = rng.normal(size=(25, 3))
    planes = hull_planes(hull)
    points = 1.5 * rng.normal(size=(40, 5, 3))
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    enter, leave = clip_lines(points, directions, planes)
    hit = np.isfinite(enter)
    assert 20 < hit.sum() < 190
    np.testing.assert_array_equal(hit, np.isfinite(leave))

    def depth(t):
        at = points + t[..., None] * directions[:, None]
        return (planes[:, 3] - at @ planes[:, :3].T).min(axis=-1)

    for end, inward in ((enter, 1e-6), (leave, -1e-6)):
        safe = np.where(hit, end, 0.0)
        assert (depth(safe + inward)[hit] > -1e-12).all()
        assert (depth(safe - inward)[hit] < 1e-12).all()
    along = np.linspace(-6, 6, 400)
    inside = np.stack([depth(np.full(hit.shape, t)) for t in along]).max(axis=0)
    assert (inside[~hit] < 0).all()
