"""Objects to be manipulated: convex pieces, mass properties and looks, shared by physics and planner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from regrasp_gym.rendering.surfaces import COLLISION_GROUP, Look, Rgba, add_look, faceted

if TYPE_CHECKING:
    from regrasp_planner.task import Body

MAX_HULL_VERTICES = 64
"""Vertex limit of a convex piece: with more, MuJoCo's resting contacts jitter."""


@dataclass(frozen=True)
class Contact:
    """Softness of an object's contacts, in terms of MuJoCo's geoms.

    Attributes:
        solref: time constant (seconds) and damping ratio.
        solimp: impedance without overlap and at full overlap, and the overlap (metres) over which it rises.
        solmix: weight of these values against those of the other geom.
    """

    solref: tuple[float, float] = (0.006, 1.0)
    solimp: tuple[float, float, float] = (0.95, 0.99, 0.001)
    solmix: float = 1.0


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object made of convex pieces.

    The frame has its origin at the centre of mass, and z points up when the object stands upright.

    Attributes:
        name: identifier, for example ``"004_sugar_box"``.
        label: name in instructions, for example ``"sugar box"``.
        mass: kilograms.
        pieces: convex pieces, (N, 3) vertices each, N ≤ 64, metres, object frame.
        inertia: (3, 3) about the centre of mass in the object frame, kg·m².
        shape: ``"box"`` for a single box aligned with the frame, else ``"mesh"``.
        looks: visible surfaces; without any, the pieces are drawn in ``rgba``.
        rgba: colour of the pieces if there are no looks.
        friction: sliding friction coefficient; the gripper's pads override it with their own.
        contact: softness of its contacts.
    """

    name: str
    label: str
    mass: float
    pieces: tuple[Float[np.ndarray, "N 3"], ...]
    inertia: Float[np.ndarray, "3 3"]
    shape: Literal["box", "mesh"] = "mesh"
    looks: tuple[Look, ...] = ()
    rgba: Rgba = (0.7, 0.7, 0.7, 1.0)
    friction: float = 0.6
    contact: Contact = Contact()

    @cached_property
    def size(self) -> Float[np.ndarray, " 3"]:
        """(3,) extents of the upright object along x, y and z, metres."""
        points = np.concatenate(self.pieces)
        return np.ptp(points, axis=0)

    @property
    def height(self) -> float:
        """Height of the upright object, metres."""
        return float(self.size[2])

    @cached_property
    def _body(self) -> Body:
        # Imported here because it loads JAX, which the physics does not need.
        from regrasp_planner.geometry.support import ConvexBody
        from regrasp_planner.task import Body

        pieces = tuple(ConvexBody.from_vertices(piece) for piece in self.pieces)
        return Body(self.name, pieces, np.zeros(3), self.mass)

    def body(self) -> Body:
        """The planner's body of this object, made once."""
        return self._body

    def add_to(
        self,
        spec: mujoco.MjSpec,
        name: str | None = None,
        pose: Float[np.ndarray, " 7"] | None = None,
        *,
        free: bool = True,
        parent: mujoco.MjsBody | None = None,
    ) -> mujoco.MjsBody:
        """Add the object to a MuJoCo specification.

        Args:
            spec: the specification, changed in place. Two copies of an object share meshes, textures and materials.
            name: name of the body, the object's own name by default; the free joint is called ``{name}_joint``.
            pose: (7,) wxyz_xyz in the parent's frame, the identity by default.
            free: whether the body moves freely; otherwise it is fixed to its parent.
            parent: the world by default.

        Returns:
            The new body. Its collision geoms ``{name}_c0`` … are in group 3, its visible geoms in group 2.
        """
        name = name or self.name
        pose = np.array([1.0, 0, 0, 0, 0, 0, 0]) if pose is None else np.asarray(pose, float)
        body = (parent or spec.worldbody).add_body(name=name, pos=pose[4:], quat=pose[:4])
        if free:
            body.add_freejoint(name=f"{name}_joint")
        body.mass = self.mass
        body.ipos = np.zeros(3)
        i = self.inertia
        body.fullinertia = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
        body.explicitinertial = True
        for k, piece in enumerate(self.pieces):
            geom = body.add_geom(
                name=f"{name}_c{k}",
                group=COLLISION_GROUP,
                condim=4,
                friction=[self.friction, 0.004, 0.0001],
                solref=self.contact.solref,
                solimp=[*self.contact.solimp, 0.5, 2],
                solmix=self.contact.solmix,
                rgba=[*self.rgba[:3], 0.5],
            )
            if self.shape == "box":
                geom.type = mujoco.mjtGeom.mjGEOM_BOX
                geom.size = self.size / 2
            else:
                geom.type = mujoco.mjtGeom.mjGEOM_MESH
                geom.meshname = self._collision_mesh(spec, k, piece)
        for k, look in enumerate(self.looks or self._plain_looks):
            add_look(spec, body, f"{self.name}_v{k}", look, geom_name=f"{name}_v{k}")
        return body

    @cached_property
    def _plain_looks(self) -> tuple[Look, ...]:
        return tuple(faceted(piece, self.rgba) for piece in self.pieces)

    def _collision_mesh(self, spec: mujoco.MjSpec, k: int, piece: np.ndarray) -> str:
        meshname = f"{self.name}_c{k}"
        if spec.mesh(meshname) is None:
            hull = ConvexHull(piece)
            mesh = spec.add_mesh(name=meshname, maxhullvert=MAX_HULL_VERTICES)
            mesh.uservert = piece.ravel()
            mesh.userface = _outward(piece, hull).ravel()
        return meshname


def solid(
    name: str,
    label: str,
    mass: float,
    pieces: Sequence[Float[np.ndarray, "N 3"]],
    *,
    shape: Literal["box", "mesh"] = "mesh",
    looks: Sequence[Look] = (),
    rgba: Rgba = (0.7, 0.7, 0.7, 1.0),
    friction: float = 0.6,
    contact: Contact = Contact(),
) -> ObjectModel:
    """An object of uniform density, with its frame moved to the centre of mass of ``pieces``.

    Args:
        name, label, mass, rgba, friction, contact, shape: see `ObjectModel`.
        pieces: convex pieces that do not overlap, (N, 3) metres, z up.
        looks: surfaces in the same frame as ``pieces``.
    """
    volume, center, second = 0.0, np.zeros(3), np.zeros((3, 3))
    for piece in pieces:
        v, c, s = _moments(np.asarray(piece, float))
        volume, center, second = volume + v, center + v * c, second + s
    center = center / volume
    second = second - volume * np.outer(center, center)
    inertia = mass / volume * (np.trace(second) * np.eye(3) - second)
    return ObjectModel(
        name=name,
        label=label,
        mass=mass,
        pieces=tuple(np.asarray(piece, float) - center for piece in pieces),
        inertia=inertia,
        shape=shape,
        looks=tuple(look.shifted(-center) for look in looks),
        rgba=rgba,
        friction=friction,
        contact=contact,
    )


def _moments(points: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, centroid and ∫xxᵀdV of the hull of ``points`` about the frame's origin, summed over tetrahedra.

    Neither trimesh nor `regrasp_planner.geometry.hull.mass_properties` serves here: both round differently, and scenes
    are equal to the last bit as long as this function rounds as it does.
    """
    hull = ConvexHull(points)
    inside = points.mean(axis=0)
    corners = points[hull.simplices] - inside
    volumes = np.abs(np.linalg.det(corners)) / 6
    volume = volumes.sum()
    sums = corners.sum(axis=1)
    centroid = (volumes[:, None] * sums).sum(axis=0) / 4 / volume
    # For a tetrahedron with one corner at the origin: ∫xxᵀ = V/20 (Σ aᵢaᵢᵀ + (Σ aᵢ)(Σ aᵢ)ᵀ).
    second = np.einsum("t,tij,tik->jk", volumes, corners, corners) + np.einsum("t,tj,tk->jk", volumes, sums, sums)
    second = second / 20
    center = centroid + inside
    moment = volume * (np.outer(inside, centroid) + np.outer(centroid, inside) + np.outer(inside, inside))
    return float(volume), center, second + moment


def _outward(points: np.ndarray, hull: ConvexHull) -> Int[np.ndarray, "M 3"]:
    """Hull triangles ordered counter-clockwise from outside."""
    faces = hull.simplices.copy()
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    flip = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    faces[flip] = faces[flip][:, ::-1]
    return faces
