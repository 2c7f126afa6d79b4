"""Objects from mesh files: convex pieces with the mesh's mass properties and looks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from regrasp_gym.objects.decompose import MAX_PIECES, convex_pieces
from regrasp_gym.objects.model import MAX_HULL_VERTICES, ObjectModel
from regrasp_gym.rendering.surfaces import Look, Rgba
from regrasp_planner import GeometryError
from regrasp_planner.geometry.hull import reduced_hull

if TYPE_CHECKING:
    import trimesh

HUGE = 5.0
"""Extent in metres above which a mesh is probably in other units."""

FILLED = 0.85
"""Share of its hull that a mesh must fill to count as convex: cans and bottles do, cups do not."""

BASE = 1e-3
"""Unevenness of the base that counts as noise, metres; at most 2 % of the height."""

LEAST_FILLED = 1e-3
"""A mesh that fills a smaller share of its hull has no meaningful inside."""

SEAMS = 1e-3
"""Share of edges without two faces that a closed mesh may have."""

TEXTURE_EDGE = 512
"""Textures are reduced to this edge length in pixels."""


class MeshError(GeometryError):
    """A mesh that cannot become an object: unreadable, not finite, no faces or no volume."""


class MeshWarning(UserWarning):
    """An assumption about a mesh with holes, hollows or an implausible size."""


def object_from_mesh(
    source: str | Path | tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"]],
    mass: float | None = None,
    *,
    density: float | None = None,
    name: str | None = None,
    label: str | None = None,
    scale: float = 1.0,
    rgba: Rgba = (0.7, 0.7, 0.7, 1.0),
    friction: float = 0.6,
    max_pieces: int = MAX_PIECES,
) -> ObjectModel:
    """An object made of convex pieces with up to 64 vertices each.

    A mesh that fills at least `FILLED` of its convex hull becomes that hull, with fewer vertices. CoACD cuts any other
    closed mesh into pieces that contain it (see `regrasp_gym.objects.decompose`), so that a mug can be grasped by its
    handle; the first time may take a minute. Centre of mass and inertia are those of the closed mesh with uniform
    density. A mesh with holes has no inside and is replaced by its hull. A `MeshWarning` states each assumption.

    Args:
        source: file in a format of trimesh (OBJ, STL, PLY, …), or vertices (N, 3) and faces (M, 3). z is up.
        mass: kilograms.
        density: kg/m³, instead of the mass.
        name, label: the file's name by default.
        scale: metres per unit of the mesh; 0.001 for millimetres.
        rgba: colour if the file has no texture.
        friction: see `ObjectModel`.
        max_pieces: most convex pieces; 1 always uses the hull.

    Raises:
        FileNotFoundError: no such file.
        MeshError: the mesh is unreadable, not finite, or has no faces or volume; mass, density or scale is not
            positive; or mass and density are both given or both missing.
    """
    import trimesh

    name = name or (Path(source).stem if isinstance(source, str | Path) else "mesh")
    if (mass is None) == (density is None):
        raise MeshError(f"mesh {name!r}: give either a mass (kg) or a density (kg/m³)")
    for what, value in (("mass", mass), ("density", density), ("scale", scale)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise MeshError(f"mesh {name!r}: {what} {value} must be positive and finite")
    if max_pieces < 1:
        raise MeshError(f"mesh {name!r}: max_pieces {max_pieces} must be at least 1")
    mesh = _loaded(source, name)
    vertices = np.asarray(mesh.vertices, float) * scale
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise MeshError(f"mesh {name!r}: {len(bad)} of {len(vertices)} vertices are not finite, the first is {bad[0]}")
    hull = _hull(vertices, np.asarray(mesh.faces), name)
    extents = np.ptp(hull, axis=0)
    if extents.max() > HUGE:
        _warn(f"mesh {name!r} is {extents.max():.1f} m long; if it is in millimetres, pass scale=0.001")

    shape = trimesh.Trimesh(vertices, mesh.faces, process=True)
    if shape.volume < 0:
        shape.invert()
    solid_hull = trimesh.convex.convex_hull(vertices)
    filled = shape.volume / solid_hull.volume
    pieces = (hull,)
    if not _is_closed(shape) or filled < LEAST_FILLED:
        shape = solid_hull
        _warn(f"mesh {name!r} is not closed: its convex hull, as a solid, is used for contact, mass and inertia")
    elif filled < FILLED and max_pieces > 1:
        pieces = convex_pieces(np.asarray(shape.vertices), np.asarray(shape.faces), max_pieces=max_pieces)
    elif filled < 0.9:
        _warn(
            f"mesh {name!r} is hollow or concave: contacts treat the empty {1 - filled:.0%} of its convex hull as solid"
        )
    center = np.asarray(shape.center_mass)
    mass = float(shape.volume) * density if density is not None else mass
    assert mass is not None, "either the mass is given or the density"
    return ObjectModel(
        name=name,
        label=label or name.replace("_", " "),
        mass=mass,
        pieces=tuple(piece - center for piece in _on_a_flat_base(pieces)),
        inertia=np.asarray(shape.moment_inertia) * mass / shape.volume,
        looks=(_look(mesh, scale, rgba).shifted(-center),),
        rgba=rgba,
        friction=friction,
    )


def _on_a_flat_base(pieces: Sequence[Float[np.ndarray, "K 3"]]) -> list[Float[np.ndarray, "K 3"]]:
    """The pieces, with all points within `BASE` of the lowest one lowered to it.

    Scans of flat bottoms are uneven by tenths of a millimetre, and an object on three points rocks.
    """
    level = min(piece[:, 2].min() for piece in pieces)
    noise = min(BASE, 0.02 * (max(piece[:, 2].max() for piece in pieces) - level))
    flat: list[np.ndarray] = []
    for piece in pieces:
        heights = np.where(piece[:, 2] < level + noise, level, piece[:, 2])
        lowered = np.column_stack([piece[:, :2], heights])
        flat.append(lowered[ConvexHull(lowered).vertices])
    return flat


def _warn(message: str) -> None:
    warnings.warn(message, MeshWarning, stacklevel=3)


def _is_closed(mesh: trimesh.Trimesh) -> bool:
    """Whether the mesh has an inside: every edge has two faces, except for the few seams of real scans."""
    count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1]
    return bool(mesh.is_winding_consistent and (count != 2).mean() <= SEAMS)


def _loaded(source: str | Path | tuple[np.ndarray, np.ndarray], name: str) -> trimesh.Trimesh:
    import trimesh

    if isinstance(source, str | Path):
        if not Path(source).is_file():
            raise FileNotFoundError(f"mesh file {str(source)!r} does not exist")
        try:
            mesh = trimesh.load(source, force="mesh", process=False)
        except Exception as error:
            # trimesh's readers raise many types of exceptions.
            raise MeshError(f"mesh file {str(source)!r} cannot be read: {error}") from error
    else:
        vertices, faces = np.asarray(source[0], float), np.asarray(source[1])
        if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
            raise MeshError(
                f"mesh {name!r}: vertices {vertices.shape} and faces {faces.shape} must be (N, 3) and (M, 3)"
            )
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            raise MeshError(f"mesh {name!r}: a face names a vertex outside 0…{len(vertices) - 1}")
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise MeshError(f"mesh {name!r} has no faces")
    return mesh


def _hull(vertices: np.ndarray, faces: np.ndarray, name: str) -> Float[np.ndarray, "K 3"]:
    used = vertices[np.unique(faces)]
    try:
        return reduced_hull(used, MAX_HULL_VERTICES)[0]
    except GeometryError as error:
        raise MeshError(f"mesh {name!r} has no volume, not even its convex hull: {error}") from error


def _look(mesh: trimesh.Trimesh, scale: float, rgba: Rgba) -> Look:
    """The mesh itself, with its texture if there is one."""
    from PIL import Image

    texture, coords = None, getattr(mesh.visual, "uv", None)
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if coords is not None and isinstance(image, Image.Image):
        picture = image.convert("RGB")
        picture.thumbnail((TEXTURE_EDGE, TEXTURE_EDGE))
        texture = np.asarray(picture)
        # Files count v from the lower edge of the picture.
        coords = np.column_stack([coords[:, 0], 1 - np.asarray(coords)[:, 1]])
    return Look(
        vertices=np.asarray(mesh.vertices, float) * scale,
        faces=np.asarray(mesh.faces),
        normals=np.asarray(mesh.vertex_normals, float),
        rgba=(1.0, 1.0, 1.0, 1.0) if texture is not None else rgba,
        texcoords=coords if texture is not None else None,
        texture=texture,
    )
