"""Objects from mesh files: any OBJ, STL or PLY becomes one convex hull with the mesh's mass properties and looks."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from regrasp_gym.looks import Look, Rgba
from regrasp_gym.objects.model import MAX_HULL_VERTICES, ObjectModel, solid
from regrasp_planner import GeometryError

if TYPE_CHECKING:
    import trimesh

HUGE = 5.0
"""Extent in metres above which a mesh is taken to be in other units."""

TEXTURE_EDGE = 512
"""Textures are reduced to this edge length in pixels."""


class MeshError(GeometryError):
    """A mesh that cannot become an object: unreadable, not finite, without faces or without volume."""


class MeshWarning(UserWarning):
    """A mesh that was taken with something assumed: holes, hollows, or an implausible size."""


def object_from_mesh(
    source: str | Path | tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"]],
    mass: float,
    *,
    name: str | None = None,
    label: str | None = None,
    scale: float = 1.0,
    rgba: Rgba = (0.7, 0.7, 0.7, 1.0),
    friction: float = 0.6,
) -> ObjectModel:
    """An object whose one piece is the convex hull of a mesh, thinned out to 64 vertices.

    Centre of mass and inertia are those of the mesh filled with uniform density if it is closed, and those of the hull
    if it has holes. What was assumed is said in a `MeshWarning`.

    Args:
        source: file that trimesh reads (OBJ, STL, PLY, …), or vertices (N, 3) and faces (M, 3). z is up.
        mass: kilograms.
        name, label: the file's name by default.
        scale: metres per unit of the mesh; 0.001 for millimetres.
        rgba: colour, where the file has no texture.
        friction: see `ObjectModel`.

    Raises:
        FileNotFoundError: no such file.
        MeshError: unreadable, no faces, not finite, no volume, or a mass or scale that is not positive.
    """
    import trimesh

    name = name or (Path(source).stem if isinstance(source, str | Path) else "mesh")
    if not (np.isfinite(mass) and mass > 0 and np.isfinite(scale) and scale > 0):
        raise MeshError(f"mesh {name!r}: mass {mass} kg and scale {scale} must be positive")
    mesh = _loaded(source, name)
    vertices = np.asarray(mesh.vertices, float) * scale
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise MeshError(f"mesh {name!r}: {len(bad)} of {len(vertices)} vertices are not finite, the first is {bad[0]}")
    hull = _hull(vertices, np.asarray(mesh.faces), name)
    extents = np.ptp(hull, axis=0)
    if extents.max() > HUGE:
        warnings.warn(
            f"mesh {name!r} is {extents.max():.1f} m long; if it is in millimetres, pass scale=0.001",
            MeshWarning,
            stacklevel=2,
        )

    thing = solid(name, label or name.replace("_", " "), mass, [hull], rgba=rgba, friction=friction)
    shape = trimesh.Trimesh(vertices, mesh.faces, process=True)
    center = hull.mean(axis=0) - thing.pieces[0].mean(axis=0)
    inertia = thing.inertia
    if shape.is_volume:
        center, inertia = np.asarray(shape.center_mass), np.asarray(shape.moment_inertia) * mass / shape.volume
        filled = 1 - shape.volume / trimesh.convex.convex_hull(vertices).volume
        if filled > 0.1:
            warnings.warn(
                f"mesh {name!r} is hollow or concave: {filled:.0%} of its convex hull is filled up for contact",
                MeshWarning,
                stacklevel=2,
            )
    else:
        warnings.warn(
            f"mesh {name!r} is not closed: its convex hull is taken as a solid for contact, mass and inertia",
            MeshWarning,
            stacklevel=2,
        )
    return ObjectModel(
        name=name,
        label=thing.label,
        mass=mass,
        pieces=(hull - center,),
        inertia=inertia,
        looks=(_look(mesh, scale, rgba).shifted(-center),),
        rgba=rgba,
        friction=friction,
    )


def _loaded(source: str | Path | tuple[np.ndarray, np.ndarray], name: str) -> trimesh.Trimesh:
    import trimesh

    if isinstance(source, str | Path):
        if not Path(source).is_file():
            raise FileNotFoundError(f"mesh file {str(source)!r} does not exist")
        try:
            mesh = trimesh.load(source, force="mesh", process=False)
        except Exception as error:
            # Each of trimesh's readers raises what it likes.
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
    from regrasp_planner.geometry.hull import reduced_hull

    used = vertices[np.unique(faces)]
    try:
        hull, _ = reduced_hull(used, MAX_HULL_VERTICES)
    except GeometryError as error:
        raise MeshError(f"mesh {name!r} has no volume, not even its convex hull: {error}") from error
    return hull


def _look(mesh: trimesh.Trimesh, scale: float, rgba: Rgba) -> Look:
    """The mesh itself, with its texture if the file brings one."""
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
