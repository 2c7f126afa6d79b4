"""The collision geoms of a robot as the planner's convex bodies, and the pairs of them that may collide."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import jaxlie
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_gym.geometry.poses import mujoco_quaternion
from regrasp_gym.rendering.surfaces import COLLISION_GROUP
from regrasp_gym.robots.model_reader import ModelReader, RobotModelError
from regrasp_planner import ConvexBody


@dataclass(frozen=True)
class CollisionGeom:
    """A collision geom of the robot.

    Attributes:
        geom: id in the model.
        body: its shape, in its own frame.
        link: index of the link that carries it; the last one for the gripper.
        finger: index of the finger that it is fixed to, if any.
        palm: whether it is fixed to the palm.
    """

    geom: int
    body: ConvexBody
    link: int
    finger: int | None
    palm: bool

    def pose(self, data: mujoco.MjData) -> jaxlie.SE3:
        """Pose of the geom in the world."""
        return frame(data.geom_xpos[self.geom], mujoco_quaternion(data.geom_xmat[self.geom]))


def collision_geoms(reader: ModelReader, links: list[int], fingers: list[int], site: int) -> list[CollisionGeom]:
    """The collision geoms of these links and fingers (body ids); the palm is the body of ``site``.

    Raises:
        RobotModelError: the palm or all links are without one, or one has a shape that the planner does not know.
    """
    model = reader.model
    hand = int(model.site_bodyid[site])
    geoms: list[CollisionGeom] = []
    for geom in np.flatnonzero(model.geom_group == COLLISION_GROUP):
        body = int(model.geom_bodyid[geom])
        carrier = reader.ancestor(body, [*fingers, *links])
        if carrier is None:
            continue
        finger = fingers.index(carrier) if carrier in fingers else None
        palm = finger is None and hand not in links and reader.ancestor(body, [hand]) is not None
        link = len(links) - 1 if finger is not None else links.index(carrier)
        geoms.append(CollisionGeom(int(geom), geom_body(model, geom), link, finger, palm))
    for what, found in (("palm", any(g.palm for g in geoms)), ("links", any(not g.palm for g in geoms))):
        if not found:
            raise RobotModelError(f"robot {reader.robot!r} has no group-{COLLISION_GROUP} geom on its {what}; add one")
    return geoms


def geom_body(model: mujoco.MjModel, geom: int) -> ConvexBody:
    """The convex body of a capsule, sphere, box, cylinder or mesh geom, in the geom's own frame.

    A mesh becomes its convex hull, as in MuJoCo's collisions; a cylinder becomes a 24-gon prism around it.

    Raises:
        RobotModelError: another type of geom.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return ConvexBody.capsule(float(size[0]), 2 * float(size[1]))
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return ConvexBody.sphere(float(size[0]))
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return ConvexBody.box(2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = 2 * np.pi * np.arange(24) / 24
        ring = size[0] / np.cos(np.pi / 24) * np.column_stack([np.cos(angle), np.sin(angle)])
        ends = [np.column_stack([ring, np.full(24, z)]) for z in (-size[1], size[1])]
        return ConvexBody.from_vertices(np.concatenate(ends))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        return ConvexBody.from_vertices(np.asarray(model.mesh_vert[start : start + count], float))
    kind_name = mujoco.mjtGeom(kind).name.removeprefix("mjGEOM_").lower()
    raise RobotModelError(
        f"geom {model.geom(geom).name!r} is a {kind_name}; use a capsule, sphere, box, cylinder or mesh for collision"
    )


def self_pairs(
    reader: ModelReader,
    data: mujoco.MjData,
    geoms: Sequence[CollisionGeom],
    joints: tuple[Sequence[int], Sequence[int]],
    home: Float[np.ndarray, " n"],
    samples: int,
    pair_distance: float,
) -> Int[Array, "S 2"]:
    """(S, 2) index pairs of ``geoms`` that are worth checking; see `robot_from_model` for which.

    ``joints`` are those of the arm and of the fingers; ``data`` is moved.
    """
    model, n = reader.model, len(joints[0])
    moved = [*joints[0], *joints[1]]
    units = [g.link if g.finger is None else n + 1 for g in geoms]
    candidates = [
        (i, j)
        for i, j in itertools.combinations(range(len(geoms)), 2)
        if abs(units[i] - units[j]) > 1 and reader.may_touch(geoms[i].geom, geoms[j].geom)
    ]
    pairs = np.array(candidates, dtype=np.int32).reshape(-1, 2)
    ids = np.array([g.geom for g in geoms], dtype=np.int32)[pairs]
    rng = np.random.default_rng(0)
    limits = model.jnt_range[moved]
    near = np.zeros(len(pairs), dtype=bool)
    free_at_home = np.ones(len(pairs), dtype=bool)
    for k in range(samples + 1):
        q = np.concatenate([home, limits[n:, 1]]) if k == 0 else rng.uniform(limits[:, 0], limits[:, 1])
        set_joints(model, data, moved, q)
        for p in range(len(pairs)) if k == 0 else np.flatnonzero(~near & free_at_home):
            distance = mujoco.mj_geomDistance(model, data, ids[p, 0], ids[p, 1], pair_distance, None)
            if k == 0 and distance < 0:
                free_at_home[p] = False
            near[p] |= distance < pair_distance
    return jnp.asarray(pairs[near & free_at_home])


def set_joints(model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], q: Float[np.ndarray, " n"]) -> None:
    """Move these joints to ``q`` and update the frames of ``data``."""
    data.qpos[model.jnt_qposadr[joints]] = q
    mujoco.mj_kinematics(model, data)


def frame(position: Float[np.ndarray, " 3"], quaternion: Float[np.ndarray, " 4"]) -> jaxlie.SE3:
    """The pose of a position and a wxyz quaternion."""
    return jaxlie.SE3(jnp.asarray(np.concatenate([quaternion, position])))
