"""Convex decomposition: coverage, the store on disk, and bad meshes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from scipy.spatial import ConvexHull

from regrasp_gym.objects import decompose
from regrasp_gym.objects.decompose import convex_pieces, covering
from regrasp_planner import GeometryError

Mesh = tuple[np.ndarray, np.ndarray]

pytestmark = pytest.mark.usefixtures("own_cache")


def mug() -> trimesh.Trimesh:
    """Wall, floor and handle, three closed meshes that run through each other."""
    wall = trimesh.creation.annulus(0.036, 0.041, 0.08, sections=16)
    floor = trimesh.creation.cylinder(0.039, 0.006, sections=16)
    floor.apply_translation([0, 0, -0.037])
    handle = trimesh.creation.torus(0.024, 0.005, major_sections=16, minor_sections=8)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    handle.apply_translation([0.06, 0, 0])
    return trimesh.util.concatenate([wall, floor, handle])


def beyond(points: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """How far each point is outside of a piece, metres (a lower bound), negative inside."""
    planes = ConvexHull(piece).equations
    return (points @ planes[:, :3].T + planes[:, 3]).max(axis=1)


def test_the_pieces_hold_the_mesh_and_leave_the_hollow_free() -> None:
    mesh = mug()
    pieces = convex_pieces(mesh.vertices, mesh.faces)
    assert 8 <= len(pieces) <= 16
    assert all(len(piece) <= 64 for piece in pieces)
    surface = trimesh.sample.sample_surface(mesh, 4000, seed=0)[0]
    assert np.min([beyond(surface, piece) for piece in pieces], axis=0).max() < 5e-5
    # The hollow of the cup, the hole of the handle: what fingers reach into.
    rng = np.random.default_rng(0)
    turn, radius, z = rng.uniform(0, 2 * np.pi, 500), rng.uniform(0, 0.028, 500), rng.uniform(-0.03, 0.04, 500)
    hollow = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])
    hole = np.column_stack(
        [rng.uniform(0.053, 0.067, 200), rng.uniform(-0.005, 0.005, 200), rng.uniform(-5e-3, 5e-3, 200)]
    )
    for points in (hollow, hole):
        assert np.min([beyond(points, piece) for piece in pieces], axis=0).min() > 0


def test_fewer_pieces_can_be_asked_for() -> None:
    ring = trimesh.creation.annulus(0.03, 0.036, 0.07, sections=12)
    assert len(convex_pieces(ring.vertices, ring.faces)) > 5
    assert len(convex_pieces(ring.vertices, ring.faces, max_pieces=5)) == 5


def assert_same(pieces: tuple[np.ndarray, ...], others: tuple[np.ndarray, ...]) -> None:
    assert len(pieces) == len(others)
    for a, b in zip(pieces, others, strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_second_call_computes_nothing(own_cache: Path, angle: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    first = convex_pieces(*angle)
    (file,) = (own_cache / "pieces").iterdir()
    assert file.suffix == ".npz"
    with monkeypatch.context() as patch:
        patch.setattr(subprocess, "run", None)
        assert_same(convex_pieces(*angle), first)
    file.unlink()
    assert_same(convex_pieces(*angle), first)


def test_other_meshes_and_options_have_files_of_their_own(own_cache: Path, angle: Mesh) -> None:
    convex_pieces(*angle)
    convex_pieces(*angle, threshold=0.2)
    convex_pieces(angle[0] * 1.01, angle[1])
    assert len(list((own_cache / "pieces").iterdir())) == 3


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 half a file", None])
def test_a_damaged_file_is_rebuilt(own_cache: Path, angle: Mesh, damage: bytes | None) -> None:
    first = convex_pieces(*angle)
    (file,) = (own_cache / "pieces").iterdir()
    if damage is None:
        np.savez(file, piece_0=np.full((5, 3), np.nan))
    else:
        file.write_bytes(damage)
    assert_same(convex_pieces(*angle), first)
    with np.load(file) as stored:
        assert len(stored.files) == 2


def test_pieces_that_cannot_be_stored_are_still_returned(
    tmp_path: Path, angle: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("REGRASP_CACHE_DIR", str(tmp_path / "file"))
    with pytest.warns(UserWarning, match="set REGRASP_CACHE_DIR to a folder"):
        assert len(convex_pieces(*angle)) == 2


def test_a_failure_of_coacd_is_reported() -> None:
    with pytest.raises(GeometryError, match=r"CoACD cannot decompose the mesh of 0 faces.*pass max_pieces=1"):
        decompose._run_coacd(trimesh.creation.box().vertices, np.zeros((0, 3), int), 4, 0.05)


def test_coacd_is_stopped_when_it_takes_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ring and a disc that run through each other in one mesh: alone, CoACD takes each of them."""
    ring = trimesh.creation.torus(0.03, 0.008, major_sections=12, minor_sections=6)
    disc = trimesh.creation.cylinder(0.04, 0.006, sections=12)
    disc.apply_translation([0.02, 0, 0])
    both = trimesh.util.concatenate([ring, disc])
    monkeypatch.setattr(decompose, "_PATIENCE", 1.0)
    with pytest.raises(GeometryError, match="no end after 1 s"):
        decompose._run_coacd(np.asarray(both.vertices), np.asarray(both.faces), 8, 0.05)
    monkeypatch.undo()
    assert 3 < len(convex_pieces(both.vertices, both.faces, max_pieces=8)) <= 8


@pytest.mark.parametrize(("pieces", "threshold"), [(0, 0.05), (4, 0.0), (4, 2.0)])
def test_options_out_of_range_are_refused(angle: Mesh, pieces: int, threshold: float) -> None:
    with pytest.raises(ValueError, match=f"max_pieces {pieces} .* threshold {threshold}"):
        convex_pieces(*angle, max_pieces=pieces, threshold=threshold)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(5, 400),
    flatness=st.floats(0.02, 1.0),
    size=st.floats(0.005, 5.0),
    kept=st.integers(12, 64),
)
def test_covering_hulls_hold_all_points_and_little_more(
    seed: int, count: int, flatness: float, size: float, kept: int
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= np.array([1.0, 1.0, flatness]) * size / np.linalg.norm(points, axis=1, keepdims=True)
    cover = covering(points, kept)
    assert len(cover) <= kept
    assert beyond(points, cover).max() < 1e-8
    # An ellipsoid with n facets of equal size is overtopped by about 4π/n of its radius; twice that with uneven ones.
    assert beyond(cover, points).max() <= 8 * np.pi / kept * size
    if len(ConvexHull(points).vertices) <= kept:
        assert beyond(cover, points).max() < 1e-9
