"""The planner's robot, read from a compiled MuJoCo model, so that physics and planner share one description."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import jaxlie
import mujoco
import numpy as np
from jaxtyping import Float

from regrasp_gym.geometry.poses import mujoco_quaternion
from regrasp_gym.rendering.surfaces import COLLISION_GROUP
from regrasp_gym.robots.collision_geoms import CollisionGeom, collision_geoms, frame, self_pairs, set_joints
from regrasp_gym.robots.model_reader import ModelReader, RobotModelError
from regrasp_gym.robots.setup import RobotSetup
from regrasp_planner import Arm, ConvexBody, Gripper, Robot

_WIDTH_AXIS = (0.0, 1.0, 0.0)
_APPROACH_AXIS = (0.0, 0.0, 1.0)

_SAMPLES = 400
"""Random configurations that select the self-collision pairs."""


def robot_from_model(model: mujoco.MjModel, setup: RobotSetup) -> Robot:
    """The robot in a model. Its bodies are the collision geoms (group 3) of its links, hand and fingers.

    Self-collision pairs are all pairs of bodies on different links, except pairs on neighbouring links, pairs that the
    model excludes or its contact masks rule out, pairs that overlap at home (fat capsules around joints), the two
    fingers (they are made to meet), and pairs that stay farther apart than ``setup.pair_distance`` in 400 random
    configurations.

    Args:
        model: compiled model; everything else in it is ignored.
        setup: names and limits.

    Raises:
        RobotModelError: the model lacks a name, or its structure is not as described.
    """
    reader = ModelReader(model, setup.name)
    count = len(setup.arm_joints)
    for what in ("max_velocity", "max_acceleration", "home"):
        if (shape := np.shape(getattr(setup, what))) != (count,):
            raise RobotModelError(f"{what} of {setup.name!r} has shape {shape}; give ({count},)")
    parts = _find_parts(reader, setup)

    data = mujoco.MjData(model)
    set_joints(model, data, [*parts.joints, *parts.finger_joints], np.zeros(count + 2))
    frames = [frame(data.xpos[b], data.xquat[b]) for b in parts.links]
    tool = frame(data.site_xpos[parts.site], mujoco_quaternion(data.site_xmat[parts.site]))
    arm = Arm(
        origins=jnp.stack([(a.inverse() @ b).wxyz_xyz for a, b in itertools.pairwise(frames)]),
        axes=jnp.asarray(model.jnt_axis[parts.joints]),
        lower=jnp.asarray(model.jnt_range[parts.joints, 0]),
        upper=jnp.asarray(model.jnt_range[parts.joints, 1]),
        max_velocity=jnp.asarray(setup.max_velocity, float),
        max_acceleration=jnp.asarray(setup.max_acceleration, float),
        base=frames[0].wxyz_xyz,
        tool=(frames[-1].inverse() @ tool).wxyz_xyz,
        joint_names=tuple(setup.arm_joints),
    )
    geoms = collision_geoms(reader, parts.links, parts.fingers, parts.site)
    palm = [g for g in geoms if g.palm]
    fingers = [g for g in geoms if g.finger is not None]
    links = [g for g in geoms if g.finger is None and not g.palm]
    lower, upper = _travel(reader, parts.finger_joints)
    gripper = Gripper(
        palm=_stacked(palm, data, [tool] * len(palm)),
        fingers=_stacked(fingers, data, [tool] * len(fingers)),
        finger_of=jnp.asarray([g.finger for g in fingers], dtype=jnp.int32),
        contact=jnp.asarray(_contact(reader, fingers, parts.pads), dtype=jnp.int32),
        screws=jnp.asarray(np.stack([_twist(model, data, joint, tool) for joint in parts.finger_joints])),
        lower=jnp.asarray(lower),
        upper=jnp.asarray(upper),
        width_axis=jnp.asarray(_WIDTH_AXIS, float),
        approach_axis=jnp.asarray(_APPROACH_AXIS, float),
        max_opening=jnp.asarray(_max_opening(reader, data, parts, (lower, upper))),
    )
    return Robot(
        arm=arm,
        gripper=gripper,
        links=_stacked(links, data, [frames[g.link] for g in links]),
        link_of=jnp.asarray([g.link for g in links], dtype=jnp.int32),
        self_pairs=self_pairs(
            reader,
            data,
            [*links, *palm, *fingers],
            (parts.joints, parts.finger_joints),
            setup.home,
            _SAMPLES,
            setup.pair_distance,
        ),
        home=jnp.asarray(setup.home, float),
        name=setup.name,
    )


@dataclass(frozen=True)
class _Parts:
    """Ids of the robot's parts: bodies of links and fingers, joints of both, pads (geoms) and tool site."""

    links: list[int]
    fingers: list[int]
    joints: list[int]
    finger_joints: list[int]
    pads: list[int]
    site: int


def _find_parts(reader: ModelReader, setup: RobotSetup) -> _Parts:
    kinds, model = mujoco.mjtObj, reader.model
    joint_ids = [reader.find(kinds.mjOBJ_JOINT, joint) for joint in setup.arm_joints]
    finger_ids = [reader.find(kinds.mjOBJ_JOINT, joint) for joint in setup.finger_joints]
    pad_ids = [reader.find(kinds.mjOBJ_GEOM, pad) for pad in setup.pads]
    base_id = reader.find(kinds.mjOBJ_BODY, setup.base)
    site = reader.find(kinds.mjOBJ_SITE, setup.tcp_site)
    links = [base_id, *reader.chain(base_id, joint_ids)]
    fingers = [int(model.jnt_bodyid[j]) for j in finger_ids]
    if any(reader.parent_link(body, links) != len(joint_ids) for body in fingers):
        raise RobotModelError(f"a finger of {reader.robot!r} is not carried by the last link, {setup.arm_joints[-1]!r}")
    return _Parts(links, fingers, joint_ids, finger_ids, pad_ids, site)


def _twist(model: mujoco.MjModel, data: mujoco.MjData, joint: int, tool: jaxlie.SE3) -> Float[np.ndarray, " 6"]:
    """Twist (v, ω) of a finger joint per unit of its position, in the gripper frame."""
    inverse = tool.inverse()
    axis = np.asarray(inverse.rotation().apply(jnp.asarray(data.xaxis[joint])))
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return np.concatenate([axis, np.zeros(3)])
    anchor = np.asarray(inverse.apply(jnp.asarray(data.xanchor[joint])))
    return np.concatenate([-np.cross(axis, anchor), axis])


def _travel(reader: ModelReader, fingers: Sequence[int]) -> tuple[float, float]:
    """Range of θ in which both finger joints keep their limits."""
    ranges = reader.model.jnt_range[fingers]
    lower, upper = max(r[0] for r in ranges), min(r[1] for r in ranges)
    if not lower < upper:
        raise RobotModelError(f"the finger joints of {reader.robot!r} have no common travel: {ranges}")
    return float(lower), float(upper)


def _max_opening(reader: ModelReader, data: mujoco.MjData, parts: _Parts, travel: tuple[float, float]) -> float:
    """Distance between the pads at the greatest θ, metres; ``data`` is left at θ = 0."""
    model, gaps = reader.model, []
    for theta in travel:
        set_joints(model, data, parts.finger_joints, np.full(2, theta))
        gap = mujoco.mj_geomDistance(model, data, parts.pads[0], parts.pads[1], 100.0, None)
        gaps.append(round(float(gap), 9))
    set_joints(model, data, parts.finger_joints, np.zeros(2))
    if gaps[1] <= gaps[0]:
        raise RobotModelError(
            f"the gripper of {reader.robot!r} does not open with growing θ: reverse the axes of its finger joints"
        )
    return gaps[1]


def _contact(reader: ModelReader, fingers: Sequence[CollisionGeom], pads: Sequence[int]) -> list[int]:
    """Index of each pad among the geoms of the fingers."""
    index = {g.geom: k for k, g in enumerate(fingers)}
    if {fingers[index[pad]].finger for pad in pads if pad in index} != {0, 1}:
        names = tuple(reader.model.geom(pad).name for pad in pads)
        raise RobotModelError(f"pads {names} of {reader.robot!r} must be group-{COLLISION_GROUP} geoms, one per finger")
    return [index[pad] for pad in pads]


def _stacked(geoms: Sequence[CollisionGeom], data: mujoco.MjData, frames: Sequence[jaxlie.SE3]) -> ConvexBody:
    """The bodies of the geoms, each in its own of the ``frames``."""
    return ConvexBody.stack(
        [g.body.transformed(f.inverse() @ g.pose(data)) for g, f in zip(geoms, frames, strict=True)]
    )
