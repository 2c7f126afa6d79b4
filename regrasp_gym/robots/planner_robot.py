"""The planner's robot, read from a compiled MuJoCo model, so that physics and planner share one description."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import jaxlie
import mujoco
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner import Arm, ConvexBody, Gripper, RegraspError, Robot

COLLISION_GROUP = 3
"""Geoms of this group are what the planner takes for the robot's shape."""


class RobotModelError(RegraspError, ValueError):
    """The model is no serial arm with a two-finger gripper under the names given."""


def robot_from_model(
    model: mujoco.MjModel,
    *,
    name: str,
    base: str,
    joints: Sequence[str],
    tool_site: str,
    finger_joints: tuple[str, str],
    pads: tuple[str, str],
    max_velocity: Float[np.ndarray, " n"],
    max_acceleration: Float[np.ndarray, " n"],
    home: Float[np.ndarray, " n"],
    finger_ratios: tuple[float, float] = (1.0, 1.0),
    width_axis: Sequence[float] = (0.0, 1.0, 0.0),
    approach_axis: Sequence[float] = (0.0, 0.0, 1.0),
    samples: int = 400,
    reach: float = 0.15,
) -> Robot:
    """The robot of a model, with bodies from the collision geoms (group 3) of its links, hand and fingers.

    Pairs for self-collision are all pairs of bodies on different links, except those that cannot tell anything: on
    neighbouring links, excluded in the model or by its contact masks, overlapping at ``home`` already (fat capsules
    around joints), the two fingers (they are made to meet), and pairs that do not come within ``reach`` of each other
    in ``samples`` random configurations.

    Args:
        model: compiled model; it may hold other things, they are ignored.
        name: of the robot, for messages.
        base: body of link 0, fixed to the world.
        joints: the n hinge joints of the arm from base to wrist. Every joint must sit at the origin of its body.
        tool_site: site at the grasp centre; its frame is the gripper frame.
        finger_joints: slide or hinge joint of each finger, children of what the last link carries.
        pads: geom of each finger that touches the target.
        max_velocity, max_acceleration: (n,) rad/s and rad/s².
        home: (n,) rad.
        finger_ratios: position of each finger joint per unit of the finger coordinate θ.
        width_axis, approach_axis: unit axes in the gripper frame.
        samples, reach: how often and how near (metres) a pair must come to count.

    Raises:
        RobotModelError: a name that the model does not have, or a structure that is not as described.
    """
    reader = _Reader(model, name)
    joint_ids = [reader.find(mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in joints]
    finger_ids = [reader.find(mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in finger_joints]
    pad_ids = [reader.find(mujoco.mjtObj.mjOBJ_GEOM, pad) for pad in pads]
    base_body = reader.find(mujoco.mjtObj.mjOBJ_BODY, base)
    site = reader.find(mujoco.mjtObj.mjOBJ_SITE, tool_site)
    for array, what in ((max_velocity, "max_velocity"), (max_acceleration, "max_acceleration"), (home, "home")):
        if np.shape(array) != (len(joint_ids),):
            raise RobotModelError(f"{what} of {name!r} has shape {np.shape(array)}, it needs ({len(joint_ids)},)")
    link_bodies = [base_body, *reader.chain(base_body, joint_ids)]
    finger_bodies = [int(model.jnt_bodyid[j]) for j in finger_ids]
    if pads[0] == pads[1]:
        raise RobotModelError(f"pads {pads} of {name!r} must be two geoms, one on each finger")
    if any(reader.parent_unit(body, link_bodies) != len(joint_ids) for body in finger_bodies):
        raise RobotModelError(f"a finger of {name!r} is not carried by the last link, {joints[-1]!r}")

    data = mujoco.MjData(model)
    _set_joints(model, data, [*joint_ids, *finger_ids], np.zeros(len(joint_ids) + 2))
    frames = [_frame(data.xpos[b], data.xquat[b]) for b in link_bodies]
    tool = _frame(data.site_xpos[site], _quaternion(data.site_xmat[site]))
    arm = Arm(
        origins=jnp.stack([(a.inverse() @ b).wxyz_xyz for a, b in itertools.pairwise(frames)]),
        axes=jnp.asarray(model.jnt_axis[joint_ids]),
        lower=jnp.asarray(model.jnt_range[joint_ids, 0]),
        upper=jnp.asarray(model.jnt_range[joint_ids, 1]),
        max_velocity=jnp.asarray(max_velocity, float),
        max_acceleration=jnp.asarray(max_acceleration, float),
        base=frames[0].wxyz_xyz,
        tool=(frames[-1].inverse() @ tool).wxyz_xyz,
        joint_names=tuple(joints),
    )

    parts = _parts(reader, link_bodies, finger_bodies, site)
    screws = np.stack(
        [ratio * _twist(model, data, joint, tool) for joint, ratio in zip(finger_ids, finger_ratios, strict=True)]
    )
    lower, upper = _travel(reader, finger_ids, finger_ratios)
    opening = [_gap(model, data, finger_ids, pad_ids, finger_ratios, theta) for theta in (lower, upper)]
    if opening[1] <= opening[0]:
        raise RobotModelError(f"the gripper of {name!r} does not open with growing θ: swap the signs of finger_ratios")
    fingers = [part for part in parts if part.finger is not None]
    contact = [next((k for k, part in enumerate(fingers) if part.geom == pad), None) for pad in pad_ids]
    if contact[0] is None or contact[1] is None or fingers[contact[0]].finger == fingers[contact[1]].finger:
        raise RobotModelError(f"pads {pads} of {name!r} must be group-{COLLISION_GROUP} geoms, one on each finger")
    gripper = Gripper(
        palm=_stacked([part for part in parts if part.palm], data, tool),
        fingers=_stacked(fingers, data, tool),
        finger_of=jnp.asarray([part.finger for part in fingers], dtype=jnp.int32),
        contact=jnp.asarray(contact, dtype=jnp.int32),
        screws=jnp.asarray(screws),
        lower=jnp.asarray(lower),
        upper=jnp.asarray(upper),
        width_axis=jnp.asarray(width_axis, float),
        approach_axis=jnp.asarray(approach_axis, float),
        max_opening=jnp.asarray(opening[1]),
    )

    links = [part for part in parts if part.finger is None and not part.palm]
    link_frames = [jaxlie.SE3(jnp.asarray(frames[part.link].wxyz_xyz)) for part in links]
    ordered = [*links, *(part for part in parts if part.palm), *fingers]
    return Robot(
        arm=arm,
        gripper=gripper,
        links=ConvexBody.stack(
            [
                part.body.transformed(frame.inverse() @ part.pose(data))
                for part, frame in zip(links, link_frames, strict=True)
            ]
        ),
        link_of=jnp.asarray([part.link for part in links], dtype=jnp.int32),
        self_pairs=_self_pairs(reader, data, ordered, joint_ids, finger_ids, home, samples, reach),
        home=jnp.asarray(home, float),
        name=name,
    )


def geom_body(model: mujoco.MjModel, geom: int) -> ConvexBody:
    """The convex body of a capsule, sphere, box, cylinder or mesh geom, in the geom's own frame.

    A mesh counts as its convex hull, as it does in MuJoCo's collisions; a cylinder becomes a 24-gon prism around it.

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


@dataclass(frozen=True)
class _Part:
    """A collision geom of the robot and what it is fixed to: link ``link``, or finger ``finger`` of the gripper."""

    geom: int
    body: ConvexBody
    link: int
    finger: int | None
    palm: bool

    def pose(self, data: mujoco.MjData) -> jaxlie.SE3:
        return _frame(data.geom_xpos[self.geom], _quaternion(data.geom_xmat[self.geom]))


class _Reader:
    """Looks things up in a model and says clearly what is missing."""

    def __init__(self, model: mujoco.MjModel, robot: str) -> None:
        self.model = model
        self.robot = robot

    def find(self, kind: mujoco.mjtObj, name: str) -> int:
        index = mujoco.mj_name2id(self.model, kind, name)
        if index < 0:
            what = mujoco.mju_type2Str(kind)
            raise RobotModelError(f"the model has no {what} {name!r}, which robot {self.robot!r} asks for")
        return index

    def chain(self, base: int, joints: Sequence[int]) -> list[int]:
        """Bodies that the joints move, after checking that they form a serial chain of hinges from ``base``."""
        model, bodies, below = self.model, [], base
        for joint in joints:
            body, name = int(model.jnt_bodyid[joint]), model.joint(joint).name
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
                raise RobotModelError(f"joint {name!r} of robot {self.robot!r} is not a hinge")
            if model.body_jntnum[body] != 1 or np.abs(model.jnt_pos[joint]).max() > 1e-9:
                raise RobotModelError(f"joint {name!r} must be the only one of its body and sit at the body's origin")
            if not model.jnt_limited[joint]:
                raise RobotModelError(f"joint {name!r} of robot {self.robot!r} has no range")
            if self.ancestor(int(model.body_parentid[body]), [*bodies, base]) != below:
                raise RobotModelError(f"joint {name!r} of robot {self.robot!r} does not follow the one named before it")
            bodies.append(body)
            below = body
        return bodies

    def ancestor(self, body: int, among: Sequence[int]) -> int | None:
        """The first of ``among`` on the way from ``body`` to the world, itself included."""
        while body not in among:
            if body == 0:
                return None
            body = int(self.model.body_parentid[body])
        return body

    def parent_unit(self, body: int, links: Sequence[int]) -> int | None:
        found = self.ancestor(int(self.model.body_parentid[body]), links)
        return None if found is None else links.index(found)

    def may_touch(self, a: int, b: int) -> bool:
        """Whether MuJoCo's contact masks and excluded pairs of bodies let geoms a and b touch."""
        model = self.model
        masks = model.geom_contype[a] & model.geom_conaffinity[b] | model.geom_contype[b] & model.geom_conaffinity[a]
        low, high = sorted((int(model.geom_bodyid[a]), int(model.geom_bodyid[b])))
        return bool(masks) and (low << 16) + high not in model.exclude_signature


def _parts(reader: _Reader, links: list[int], fingers: list[int], site: int) -> list[_Part]:
    model = reader.model
    hand = int(model.site_bodyid[site])
    parts = []
    for geom in np.flatnonzero(model.geom_group == COLLISION_GROUP):
        body = int(model.geom_bodyid[geom])
        unit = reader.ancestor(body, [*fingers, *links])
        if unit is None:
            continue
        finger = fingers.index(unit) if unit in fingers else None
        palm = finger is None and hand not in links and reader.ancestor(body, [hand]) is not None
        link = len(links) - 1 if finger is not None else links.index(unit)
        parts.append(_Part(int(geom), geom_body(model, geom), link, finger, palm))
    for what, found in (("palm", any(part.palm for part in parts)), ("link", any(not part.palm for part in parts))):
        if not found:
            raise RobotModelError(f"robot {reader.robot!r} has no group-{COLLISION_GROUP} geom on its {what}")
    return parts


def _self_pairs(
    reader: _Reader,
    data: mujoco.MjData,
    parts: Sequence[_Part],
    joint_ids: Sequence[int],
    finger_ids: Sequence[int],
    home: Float[np.ndarray, " n"],
    samples: int,
    reach: float,
) -> Int[Array, "S 2"]:
    """(S, 2) index pairs of ``parts`` worth checking, in the numbering of `Robot.self_pairs`."""
    model = reader.model
    last = len(joint_ids)
    units = [part.link if part.finger is None else last + 1 for part in parts]
    pairs = [
        (i, j)
        for i, j in itertools.combinations(range(len(parts)), 2)
        if abs(units[i] - units[j]) > 1 and reader.may_touch(parts[i].geom, parts[j].geom)
    ]
    pairs = np.array(pairs, dtype=np.int32).reshape(-1, 2)
    geoms = np.array([part.geom for part in parts], dtype=np.int32)[pairs]
    rng = np.random.default_rng(0)
    limits = model.jnt_range[[*joint_ids, *finger_ids]]
    near = np.zeros(len(pairs), dtype=bool)
    home_free = np.ones(len(pairs), dtype=bool)
    for k in range(samples + 1):
        q = np.concatenate([home, limits[last:, 1]]) if k == 0 else rng.uniform(limits[:, 0], limits[:, 1])
        _set_joints(model, data, [*joint_ids, *finger_ids], q)
        for p in range(len(pairs)) if k == 0 else np.flatnonzero(~near & home_free):
            distance = mujoco.mj_geomDistance(model, data, geoms[p, 0], geoms[p, 1], reach, None)
            if k == 0 and distance < 0:
                home_free[p] = False
            near[p] |= distance < reach
    return jnp.asarray(pairs[near & home_free])


def _set_joints(model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int], q: np.ndarray) -> None:
    data.qpos[model.jnt_qposadr[joints]] = q
    mujoco.mj_kinematics(model, data)


def _frame(position: np.ndarray, quaternion: np.ndarray) -> jaxlie.SE3:
    return jaxlie.SE3(jnp.asarray(np.concatenate([quaternion, position])))


def _quaternion(matrix: np.ndarray) -> Float[np.ndarray, " 4"]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, matrix)
    return quaternion


def _twist(model: mujoco.MjModel, data: mujoco.MjData, joint: int, tool: jaxlie.SE3) -> Float[np.ndarray, " 6"]:
    """Twist (v, ω) of a finger joint per unit of its position, in the gripper frame."""
    inverse = tool.inverse()
    axis = np.asarray(inverse.rotation().apply(jnp.asarray(data.xaxis[joint])))
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return np.concatenate([axis, np.zeros(3)])
    anchor = np.asarray(inverse.apply(jnp.asarray(data.xanchor[joint])))
    return np.concatenate([-np.cross(axis, anchor), axis])


def _travel(reader: _Reader, fingers: Sequence[int], ratios: Sequence[float]) -> tuple[float, float]:
    """Range of θ in which both finger joints keep their limits."""
    ranges = [np.sort(reader.model.jnt_range[j] / r) for j, r in zip(fingers, ratios, strict=True)]
    lower, upper = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if not lower < upper:
        raise RobotModelError(f"the finger joints of {reader.robot!r} have no common travel: {ranges}")
    return float(lower), float(upper)


def _gap(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    fingers: Sequence[int],
    pads: Sequence[int],
    ratios: Sequence[float],
    theta: float,
) -> float:
    """Distance between the pads at θ, metres."""
    _set_joints(model, data, fingers, theta * np.asarray(ratios))
    gap = mujoco.mj_geomDistance(model, data, pads[0], pads[1], 100.0, None)
    _set_joints(model, data, fingers, np.zeros(2))
    return round(float(gap), 9)


def _stacked(parts: Sequence[_Part], data: mujoco.MjData, tool: jaxlie.SE3) -> ConvexBody:
    inverse = tool.inverse()
    return ConvexBody.stack([part.body.transformed(inverse @ part.pose(data)) for part in parts])
