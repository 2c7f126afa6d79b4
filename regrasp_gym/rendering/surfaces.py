"""Visual surfaces without collisions: shapes, and adding them to a MuJoCo model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import ConvexHull

COLLISION_GROUP = 3
"""Geom group of the shapes that touch."""

VISUAL_GROUP = 2
"""Geom group of all visual surfaces."""

_MATERIAL_COLOUR = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default geom colour: with it the material's colour applies, whatever a default class says."""

Rgba = tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Look:
    """A coloured surface.

    Attributes:
        vertices: (N, 3) metres.
        faces: (M, 3) vertex indices, counter-clockwise from outside.
        normals: (N, 3) unit outward normals.
        rgba: colour, multiplied with the texture if there is one.
        texcoords: (N, 2) texture coordinates in [0, 1], v downwards, or None.
        texture: (H, W, 3) image, first row on top, or None.
        specular, shininess: in [0, 1].
    """

    vertices: Float[np.ndarray, "N 3"]
    faces: Int[np.ndarray, "M 3"]
    normals: Float[np.ndarray, "N 3"]
    rgba: Rgba = (1.0, 1.0, 1.0, 1.0)
    texcoords: Float[np.ndarray, "N 2"] | None = None
    texture: UInt8[np.ndarray, "H W 3"] | None = None
    specular: float = 0.3
    shininess: float = 0.4

    def shifted(self, offset: Float[np.ndarray, " 3"]) -> Look:
        """The same surface moved by ``offset`` metres."""
        return replace(self, vertices=self.vertices + offset)

    def rotated(self, rotation: Float[np.ndarray, "3 3"]) -> Look:
        """The same surface turned about the origin."""
        return replace(self, vertices=self.vertices @ rotation.T, normals=self.normals @ rotation.T)

    def stretched(self, factors: Float[np.ndarray, " 3"] | float) -> Look:
        """The same surface scaled about the origin, by one factor or one for each axis."""
        factors = np.broadcast_to(np.asarray(factors, float), 3)
        normals = self.normals / factors
        normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        return replace(self, vertices=self.vertices * factors, normals=normals)

    def painted(self, rgba: Rgba, specular: float = 0.3, shininess: float = 0.4) -> Look:
        """The same surface in another colour."""
        return replace(self, rgba=rgba, specular=specular, shininess=shininess)


def add_look(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, look: Look, geom_name: str | None = None) -> None:
    """Add ``look`` to ``body``. Reuses the mesh, texture and material ``name`` if ``spec`` has them."""
    if spec.mesh(name) is None:
        mesh = spec.add_mesh(name=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        mesh.uservert = look.vertices.ravel()
        mesh.userface = look.faces.ravel()
        mesh.usernormal = look.normals.ravel()
        material = spec.add_material(name=name, rgba=look.rgba, specular=look.specular, shininess=look.shininess)
        if look.texture is not None and look.texcoords is not None:
            mesh.usertexcoord = look.texcoords.ravel()
            texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, nchannel=3)
            texture.height, texture.width = look.texture.shape[:2]
            texture.data = look.texture.tobytes()
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    body.add_geom(
        name=geom_name or name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        material=name,
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        mass=0.0,
        rgba=_MATERIAL_COLOUR,
    )


def joined(looks: Sequence[Look]) -> Look:
    """Several surfaces in one, without textures, in the colour of the first."""
    offsets = np.cumsum([0, *(len(look.vertices) for look in looks[:-1])])
    return replace(
        looks[0],
        vertices=np.concatenate([look.vertices for look in looks]),
        faces=np.concatenate([look.faces + offset for look, offset in zip(looks, offsets, strict=True)]),
        normals=np.concatenate([look.normals for look in looks]),
        texcoords=None,
        texture=None,
    )


def faceted(points: Float[np.ndarray, "N 3"], rgba: Rgba = (1.0, 1.0, 1.0, 1.0)) -> Look:
    """The hull of ``points`` with flat facets."""
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    turn = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", turn, hull.equations[:, :3]) < 0
    corners[inward] = corners[inward][:, ::-1]
    return Look(
        vertices=corners.reshape(-1, 3),
        faces=np.arange(3 * len(corners)).reshape(-1, 3),
        normals=np.repeat(hull.equations[:, :3], 3, axis=0),
        rgba=rgba,
    )


def sweep(
    path: Float[np.ndarray, "k 3"],
    half_sizes: Float[np.ndarray, "k 2"],
    side: Float[np.ndarray, " 3"],
    *,
    squareness: float = 2.0,
    sides: int = 28,
    ends: tuple[bool, bool] = (True, True),
) -> Look:
    """A tube along ``path`` with smooth shading and flat ends.

    Args:
        path: (k, 3) centres of the sections, metres.
        half_sizes: (k, 2) half sizes of the sections along ``side`` and across it, metres.
        side: a direction nowhere parallel to the path; made perpendicular to it, the first axis of the sections.
        squareness: exponent of the superellipse: 2 for an ellipse, larger for a rounded rectangle.
        sides: number of corners of a section.
        ends: whether the first and the last end are closed.
    """
    path, half_sizes = np.asarray(path, float), np.asarray(half_sizes, float)
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    first = side - tangents * (tangents @ side)[:, None]
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(tangents, first)
    angle = 2 * np.pi * np.arange(sides) / sides
    outline = np.column_stack([np.cos(angle), np.sin(angle)])
    outline = np.sign(outline) * np.abs(outline) ** (2 / squareness)
    rings = (
        path[:, None]
        + half_sizes[:, None, :1] * outline[None, :, :1] * first[:, None]
        + half_sizes[:, None, 1:] * outline[None, :, 1:] * second[:, None]
    )
    tube = grid_surface(rings, wrap=True)
    caps = [_fan(rings[k], tangents[k] * sign) for k, sign, closed in ((0, -1, ends[0]), (-1, 1, ends[1])) if closed]
    return joined([tube, *caps])


def revolve(
    profile: Sequence[tuple[float, float]],
    sides: int = 40,
    *,
    smooth: bool = True,
    texture: UInt8[np.ndarray, "H W 3"] | None = None,
) -> Look:
    """A surface of revolution about z.

    Args:
        profile: (radius, height) from bottom to top, metres.
        sides: number of facets around.
        smooth: whether shading is smooth along the profile, instead of creased at its corners.
        texture: wrapped once around, its lower edge at the start of the profile, or None.
    """
    points = np.asarray(profile, float)
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    pieces = [points] if smooth else [points[i : i + 2] for i in range(len(points) - 1)]
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    v = 1 - length / length[-1]
    surfaces, coords, start = [], [], 0
    for piece in pieces:
        radial = piece[:, None, :1] * circle[None]
        heights = np.broadcast_to(piece[:, None, 1:], (len(piece), sides + 1, 1))
        surfaces.append(grid_surface(np.concatenate([radial, heights], axis=2), wrap=False, seam=True))
        u = np.broadcast_to(angle / (2 * np.pi), (len(piece), sides + 1))
        rows = np.broadcast_to(v[start : start + len(piece), None], u.shape)
        coords.append(np.stack([u, rows], axis=2).reshape(-1, 2))
        start += len(piece) - 1
    return replace(joined(surfaces), texcoords=np.concatenate(coords), texture=texture)


def grid_surface(points: Float[np.ndarray, "k s 3"], *, wrap: bool, seam: bool = False) -> Look:
    """Quads between rings of points, split in two, with smooth normals.

    Args:
        points: (k, s, 3) rings, counter-clockwise seen against the direction from the first ring to the last.
        wrap: whether the last point of a ring joins the first.
        seam: whether the last point of a ring lies on the first (for texture coordinates), with the same normal.
    """
    k, s = points.shape[:2]
    columns = s if wrap else s - 1
    i, j = np.meshgrid(np.arange(k - 1), np.arange(columns), indexing="ij")
    a, b = (i * s + j).ravel(), (i * s + (j + 1) % s).ravel()
    faces = np.concatenate([np.column_stack([a, b, b + s]), np.column_stack([a, b + s, a + s])])
    flat = points.reshape(-1, 3)
    area = np.cross(flat[faces[:, 1]] - flat[faces[:, 0]], flat[faces[:, 2]] - flat[faces[:, 0]])
    faces, area = faces[np.linalg.norm(area, axis=1) > 1e-14], area[np.linalg.norm(area, axis=1) > 1e-14]
    normals = np.zeros_like(flat)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], area)
    if seam:
        rings = normals.reshape(k, s, 3)
        rings[:, 0] = rings[:, -1] = rings[:, 0] + rings[:, -1]
    # Coincident points (the pole of a surface of revolution) share the sum of their normals.
    for ring in (0, k - 1):
        if np.ptp(points[ring], axis=0).max() < 1e-9:
            rings = normals.reshape(k, s, 3)
            rings[ring] = rings[ring].sum(axis=0)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(flat), 1)), where=length > 0)
    return Look(vertices=flat, faces=faces, normals=normals)


def textured_box(size: Float[np.ndarray, " 3"], texture: UInt8[np.ndarray, "H W 3"]) -> Look:
    """A box of ``size`` (3,) about the origin, full edge lengths in metres, with one texture tile per face.

    The texture is an atlas of two rows and three columns: +x, +y, +z above −x, −y, −z. Tiles stand upright on the four
    vertical faces; seen from above, the tile of the top face has its upper edge towards +y.
    """
    across = {"+x": ([0, 1, 0], [0, 0, 1]), "+y": ([-1, 0, 0], [0, 0, 1]), "+z": ([1, 0, 0], [0, 1, 0])}
    across |= {"-x": ([0, -1, 0], [0, 0, 1]), "-y": ([1, 0, 0], [0, 0, 1]), "-z": ([-1, 0, 0], [0, 1, 0])}
    vertices, normals, coords, faces = [], [], [], []
    for tile, (right, up) in enumerate(across.values()):
        right, up = np.array(right, float), np.array(up, float)
        out = np.cross(right, up)
        row, column = divmod(tile, 3)
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            vertices.append((out + x * right + y * up) * size / 2)
            normals.append(out)
            coords.append(((column + 0.5 + 0.5 * x) / 3, (row + 0.5 - 0.5 * y) / 2))
        faces += [(4 * tile, 4 * tile + 1, 4 * tile + 2), (4 * tile, 4 * tile + 2, 4 * tile + 3)]
    return Look(
        vertices=np.array(vertices),
        faces=np.array(faces),
        normals=np.array(normals),
        texcoords=np.array(coords),
        texture=texture,
    )


def wall(
    outline: Float[np.ndarray, "M 2"], low: float, high: float, texture: UInt8[np.ndarray, "H W 3"] | None = None
) -> Look:
    """A smooth vertical wall on a convex outline, with u going once around from the first point.

    Args:
        outline: (M, 2) counter-clockwise, metres.
        low, high: heights of the lower and upper edge, metres.
        texture: image wrapped around the wall, or None.
    """
    closed = np.vstack([outline, outline[:1]])
    around = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    rings = np.stack([np.column_stack([closed, np.full(len(closed), z)]) for z in (low, high)])
    coords = np.stack([np.column_stack([around / around[-1], np.full(len(closed), v)]) for v in (1.0, 0.0)])
    return replace(grid_surface(rings, wrap=False, seam=True), texcoords=coords.reshape(-1, 2), texture=texture)


def _fan(ring: Float[np.ndarray, "s 3"], normal: Float[np.ndarray, " 3"]) -> Look:
    """A flat cap on a ring."""
    count = len(ring)
    turn = np.arange(count)
    faces = np.column_stack([np.full(count, count), turn, (turn + 1) % count])
    vertices = np.vstack([ring, ring.mean(axis=0)])
    if np.cross(vertices[1] - vertices[0], vertices[count] - vertices[0]) @ normal < 0:
        faces = faces[:, ::-1]
    return Look(vertices=vertices, faces=faces, normals=np.tile(normal, (count + 1, 1)))
