from __future__ import annotations

import numpy as np
import pytest
import trimesh

from regrasp_gym.geometry.facets import find_facets
from regrasp_gym.objects.stones import stone


def test_facets_agree_with_trimesh() -> None:
    for thing in map(stone, range(30)):
        facets = find_facets(thing.pieces[0])
        mesh = trimesh.convex.convex_hull(thing.pieces[0])
        assert facets.areas.sum() == pytest.approx(mesh.area)
        assert facets.volume == pytest.approx(mesh.volume)
        assert facets.solid_angles.sum() == pytest.approx(1)
        for k, normal in enumerate(facets.normals):
            part = mesh.face_normals @ normal > 1 - 1e-9
            assert facets.areas[k] == pytest.approx(mesh.area_faces[part].sum())
            corners = facets.corners(k)
            assert corners @ normal == pytest.approx((thing.pieces[0] @ normal).max())
            turned = np.cross(np.roll(corners, -1, axis=0) - corners, np.roll(corners, -2, axis=0) - corners) @ normal
            assert (turned > 0).all(), "counter-clockwise and convex"
            edges = np.roll(corners, -1, axis=0) - corners
            assert facets.shortest_edges[k] == pytest.approx(np.linalg.norm(edges, axis=1).min())
            inward = np.cross(normal, edges)
            away = -(inward * corners).sum(axis=1) / np.linalg.norm(inward, axis=1)
            assert facets.margins[k] == pytest.approx(away.min())


def test_points_inside_do_not_count() -> None:
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    facets = find_facets(cube)
    assert facets.areas == pytest.approx(np.full(6, 4.0))
    assert facets.margins == pytest.approx(np.ones(6))
    assert len(find_facets(np.vstack([cube, np.zeros(3)])).points) == 8
