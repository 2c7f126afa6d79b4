"""Convex decomposition by CoACD, cached on disk.

CoACD cuts a closed mesh along planes until each part is nearly its own convex hull (Wei, Liu, Ling, Su, "Approximate
convex decomposition for 3D meshes with collision-aware concavity and tree search", ACM TOG 2022). It takes up to a
minute for a scan, so the pieces are stored under a hash of the input.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from regrasp_gym.objects.model import MAX_HULL_VERTICES
from regrasp_gym.reports.files import replacing
from regrasp_planner.errors import GeometryError
from regrasp_planner.geometry.hull import reduced_hull

MAX_PIECES = 16
"""Most pieces of one object; each of them costs planner and physics time in every distance."""

THRESHOLD = 0.05
"""Concavity below which CoACD counts a part as convex, as a share of the object's size."""

_ITERATIONS = 60
"""Iterations of CoACD's tree search. On scans of mug and drill its default of 150 takes twice as long for no gain."""

_PATIENCE = 900.0
"""Seconds after which CoACD is stopped."""

_VOXELS = 100
"""Resolution of CoACD's repair."""

CONVEX = 0.02
"""Share of its hull that a convex part may lack because of rounding."""

_SPLINTER = 1e-5
"""Root mean square thickness in metres below which a piece is dropped."""

_LAYOUT = 1
"""Version of the stored pieces; raise it when their format or computation changes."""


def convex_pieces(
    vertices: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "M 3"],
    *,
    max_pieces: int = MAX_PIECES,
    max_vertices: int = MAX_HULL_VERTICES,
    threshold: float = THRESHOLD,
) -> tuple[Float[np.ndarray, "K 3"], ...]:
    """Convex pieces, K vertices each, that together contain a closed mesh. Deterministic.

    The first call for a mesh may take a minute; the pieces are then stored in ``$REGRASP_CACHE_DIR`` (default
    ``~/.cache/regrasp-gym``), folder ``pieces``.

    Args:
        vertices, faces: the mesh, metres; every edge has two faces, except for a few seams.
        max_pieces: CoACD merges parts, cheapest first, down to this number.
        max_vertices: most vertices of one piece, see `covering`.
        threshold: see `THRESHOLD`.

    Raises:
        ValueError: ``max_pieces`` or ``threshold`` out of range.
        GeometryError: CoACD fails on the mesh.
    """
    if max_pieces < 1 or not 0.01 <= threshold <= 1:
        raise ValueError(f"max_pieces {max_pieces} must be at least 1, and threshold {threshold} in 0.01…1")
    vertices = np.ascontiguousarray(vertices, np.float64)
    faces = np.ascontiguousarray(faces, np.int32)
    file = _cache_folder() / f"{_key(vertices, faces, max_pieces, max_vertices, threshold)}.npz"
    pieces = _read(file)
    if pieces is None:
        parts = _decomposed(vertices, faces, max_pieces, threshold)
        pieces = tuple(covering(part, max_vertices) for part in parts if not _is_flat(part))
        _write(file, pieces)
    return pieces


def _is_flat(points: np.ndarray) -> bool:
    """Whether the points are a splinter without volume, which a cut along a face can leave."""
    thickness = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(points))
    return len(points) < 4 or bool(thickness < _SPLINTER)


def covering(points: Float[np.ndarray, "N 3"], max_vertices: int) -> Float[np.ndarray, "K 3"]:
    """At most ``max_vertices`` points whose hull contains ``points`` and is little larger.

    The most prominent vertices are kept and moved outwards as little as possible, until every facet lies beyond the
    points left out. A hull with few enough vertices is returned unchanged.

    Raises:
        GeometryError: the points span no volume.
    """
    kept, _ = reduced_hull(points, max_vertices)
    for _ in range(16):
        hull = ConvexHull(kept)
        lacking = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=0)
        if lacking.max() < 1e-9:
            break
        kept = kept + _outward_steps(hull, np.maximum(lacking, 0.0))
    return kept[ConvexHull(kept).vertices]


def _outward_steps(hull: ConvexHull, needed: Float[np.ndarray, " F"]) -> Float[np.ndarray, "K 3"]:
    """For each vertex the shortest step d with n·d ≥ ``needed`` (metres) for the normals n of all its facets.

    A least distance problem min ‖d‖, N d ≥ b, solved as non-negative least squares (Lawson and Hanson, "Solving
    Least Squares Problems", 1974, ch. 23).
    """
    steps = np.zeros((len(hull.points), 3))
    scale = needed.max()
    for i in hull.vertices:
        mine = (hull.simplices == i).any(axis=1)
        if needed[mine].max() > 0:
            system = np.vstack([hull.equations[mine, :3].T, needed[mine] / scale])
            weights, _ = nnls(system, np.array([0.0, 0, 0, 1]))
            rest = system @ weights - [0, 0, 0, 1]
            steps[i] = -rest[:3] / rest[3] * scale
    return steps


def _decomposed(
    vertices: np.ndarray, faces: np.ndarray, max_pieces: int, threshold: float
) -> tuple[Float[np.ndarray, "K 3"], ...]:
    """Decompose each connected part on its own: the parts of downloaded meshes often intersect."""
    import trimesh

    whole = trimesh.Trimesh(vertices, faces, process=False)
    parts = whole.split(only_watertight=False)
    with np.errstate(all="ignore"):
        # trimesh divides by the volume of splinters.
        if not all(part.is_volume for part in parts):
            parts = [whole]
    hollow = np.array([max(part.convex_hull.volume - abs(part.volume), 0.0) for part in parts])
    convex = hollow <= CONVEX * np.array([part.convex_hull.volume for part in parts])
    left = max_pieces - int(convex.sum())
    if left < 2 * (~convex).sum():
        return _run_coacd(vertices, faces, max_pieces, threshold, remeshed=True)
    # Two for each part that is not convex, the rest by the size of the hollows.
    share = np.cbrt(hollow) * ~convex
    budget = 2 + np.floor((left - 2 * (~convex).sum()) * share / max(share.sum(), 1e-18)).astype(int)
    pieces: list[np.ndarray] = []
    for part, as_is, most in zip(parts, convex, budget, strict=True):
        if as_is:
            pieces.append(np.asarray(part.vertices, float))
        else:
            pieces += _run_coacd(np.asarray(part.vertices, float), np.asarray(part.faces), int(most), threshold)
    return tuple(pieces)


def _run_coacd(
    vertices: np.ndarray, faces: np.ndarray, max_pieces: int, threshold: float, remeshed: bool = False
) -> tuple[Float[np.ndarray, "K 3"], ...]:
    """Run CoACD in its own process: a self-intersecting mesh can crash it or keep it running for ever.

    The first try is without CoACD's repair, which takes several times as long and moves every surface outwards (0.3 mm
    on a box of 10 cm). If that fails, a second try repairs.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "mesh.npz"), Path(folder, "pieces.npz")
        np.savez(given, vertices=vertices, faces=np.asarray(faces, np.int32))
        said = ""
        for repair in ("on",) if remeshed else ("off", "on"):
            options = json.dumps(
                {
                    "threshold": threshold,
                    "max_convex_hull": max_pieces,
                    "preprocess_mode": repair,
                    "preprocess_resolution": _VOXELS,
                    "mcts_iterations": _ITERATIONS,
                    "seed": 0,
                }
            )
            # By its path: importing the package would take longer than many meshes.
            script = str(Path(__file__).with_name("run_coacd.py"))
            command = [sys.executable, script, str(given), str(made), options]
            try:
                run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                said = f"no end after {_PATIENCE:.0f} s"
                continue
            pieces = _read(made) if run.returncode == 0 else None
            if pieces is not None:
                return pieces
            said = run.stderr.strip()[-500:] or f"exit status {run.returncode}"
    raise GeometryError(
        f"CoACD cannot decompose the mesh of {len(faces)} faces ({said}); pass max_pieces=1 to use its hull"
    )


def _key(vertices: np.ndarray, faces: np.ndarray, *options: float) -> str:
    told = (_LAYOUT, version("coacd"), options, _ITERATIONS, _VOXELS, vertices.shape, faces.shape)
    digest = hashlib.sha256(repr(told).encode())
    digest.update(vertices.tobytes())
    digest.update(faces.tobytes())
    return digest.hexdigest()[:32]


def _cache_folder() -> Path:
    root = os.environ.get("REGRASP_CACHE_DIR")
    return (Path(root) if root else Path.home() / ".cache" / "regrasp-gym") / "pieces"


def _read(file: Path) -> tuple[Float[np.ndarray, "K 3"], ...] | None:
    """The stored pieces, or None if the file is missing or damaged."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            pieces = tuple(stored[f"piece_{k}"] for k in range(len(stored.files)))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = pieces and all(p.ndim == 2 and p.shape[1] == 3 and np.isfinite(p).all() for p in pieces)
    return pieces if whole else None


def _write(file: Path, pieces: Sequence[np.ndarray]) -> None:
    try:
        with replacing(file) as unfinished:
            arrays: Any = {f"piece_{k}": piece for k, piece in enumerate(pieces)}
            np.savez_compressed(unfinished, **arrays)
    except OSError as error:
        warnings.warn(
            f"the convex pieces cannot be kept in {file.parent} and are made anew each time: {error}; "
            "set REGRASP_CACHE_DIR to a folder that can be written",
            stacklevel=4,
        )
