"""Collision model shared by inverse kinematics and path planning: bodies, pairs to check, and their margins.

All bodies form one stacked list: robot bodies (numbered as in `Robot.self_pairs`), held pieces, world pieces. The pairs
to check are pairs of indices into it, each with its margin. Both lists are padded to bucket sizes, so that one compiled
program serves every scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.batching import bucket
from regrasp_planner.geometry.boxes import Boxes, core_boxes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import IDENTITY, Pose
from regrasp_planner.robot.kinematics import body_poses, robot_bodies
from regrasp_planner.robot.model import Robot
from regrasp_planner.task import Obstacle

MAX_VERTICES = 64
"""Bodies with more are thinned outwards (0.6 mm on a can): an arm needs no finer shapes, and each vertex costs time."""
WORLD_BUCKETS = (16, 32, 64, 128, 256)
HELD_BUCKETS = (1, 4, 16, 64)
PAIR_BUCKET = 256


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CollisionArrays:
    """Bodies and pairs as arrays, padded: R robot, H held and W world bodies, M = R + H + W; P pairs.

    Attributes:
        robot: the robot; its bodies are the first R of ``bodies``.
        bodies: M bodies stacked, each in its own frame, metres.
        local_poses: (M, 7) pose of a held body in the gripper frame, of a world body in the world; unused for the
            robot's bodies. Metres.
        held: (H,) indices of the held bodies; jitted code takes H from its length.
        mover: (M,) number of the last joint that moves the body; 0 for bodies that stand still.
        boxes: (M, 3) boxes about the bodies' hulls, without the sweep.
        pairs: (P, 2) indices of bodies.
        margin: (P,) distance the pair has to keep, metres; negative where some overlap is allowed.
        valid: (P,) false for padding.
    """

    robot: Robot
    bodies: ConvexBody
    local_poses: Float[Array, "M 7"]
    held: Int[Array, " H"]
    mover: Int[Array, " M"]
    boxes: Boxes
    pairs: Int[Array, "P 2"]
    margin: Float[Array, " P"]
    valid: Bool[Array, " P"]


@dataclass(frozen=True)
class CollisionModel:
    """A `CollisionArrays` with the names that messages need.

    Attributes:
        arrays: the argument of jitted functions.
        body_names: (M,) "link3", "palm", "finger0", "held", or the obstacle's name; empty for padding.
        pairs: (P, 2) the pairs, on the host.
    """

    arrays: CollisionArrays
    body_names: tuple[str, ...]
    pairs: Int[np.ndarray, "P 2"]

    def moved(self, name: str, pose: Float[np.ndarray, " 7"]) -> CollisionModel:
        """The same model with the held body or one obstacle moved, at a fraction of the cost of a new model.

        Args:
            name: "held", or the name of an obstacle.
            pose: (7,) of the held body in the gripper frame, or of the obstacle in the world.

        Raises:
            ValueError: no body has this name.
        """
        rows = [i for i, body in enumerate(self.body_names) if body == name]
        if not rows:
            known = sorted({*self.body_names} - {""})
            raise ValueError(f"the collision model has no body called {name!r}; it has {known}")
        local_poses = np.array(self.arrays.local_poses)
        local_poses[rows] = np.asarray(pose, float)
        return replace(self, arrays=replace(self.arrays, local_poses=jnp.asarray(local_poses)))

    def describe(self, pair: int) -> str:
        """Names of the two bodies of a pair."""
        a, b = self.pairs[pair]
        return f"{self.body_names[a]} – {self.body_names[b]}"

    def kind(self, pair: int) -> str:
        """ "held object", "world collision" or "self collision"."""
        a, b = self.pairs[pair]
        if "held" in (self.body_names[a], self.body_names[b]):
            return "held object"
        return "self collision" if max(a, b) < self.arrays.robot.body_count else "world collision"


class _Row(NamedTuple):
    """A body of the list: its name, the names that overrides may call it by, its mover and its local pose."""

    name: str
    groups: frozenset[str]
    mover: int
    pose: Pose = IDENTITY


def _robot_rows(robot: Robot) -> list[_Row]:
    dof = robot.arm.dof
    rows = [_Row(f"link{link}", frozenset({f"link{link}", "arm"}), int(link)) for link in np.asarray(robot.link_of)]
    rows += [_Row("palm", frozenset({"palm", "gripper"}), dof)] * robot.gripper.palm.batch_size
    for finger in np.asarray(robot.gripper.finger_of):
        rows.append(_Row(f"finger{finger}", frozenset({f"finger{finger}", "fingers", "gripper"}), dof))
    return rows


def collision_model(
    robot: Robot,
    obstacles: Sequence[Obstacle] = (),
    *,
    held: Sequence[ConvexBody] = (),
    held_pose: Float[np.ndarray, " 7"] = IDENTITY,
    margin_world: float = 0.005,
    margin_self: float = 0.0,
    margin_held: float = 0.005,
    overrides: Mapping[tuple[str, str], float | None] | None = None,
) -> CollisionModel:
    """Model of the robot, the held body and the obstacles.

    The pairs are: robot bodies and obstacles; ``robot.self_pairs``; held pieces and obstacles; held pieces and the
    arm's links, other than the last.

    Args:
        robot: the robot. Bodies that never move are not checked against obstacles.
        obstacles: bodies at poses in the world.
        held: pieces of the held body, in its own frame.
        held_pose: (7,) pose of the held body in the gripper frame.
        margin_world, margin_self, margin_held: distance to keep, metres.
        overrides: (name, name) → another margin, or None to leave the pairs out. Names are an obstacle's name or
            "world" for all; "held"; "link3", "palm", "finger0", "finger1"; "arm", "fingers", "gripper" (fingers and
            palm). Later entries win.

    Raises:
        ValueError: an override has an unknown name, or there are too many bodies.
    """
    pieces = [(piece.thinned(MAX_VERTICES), obstacle) for obstacle in obstacles for piece in obstacle.body.pieces]
    held_size = bucket(max(len(held), 1), HELD_BUCKETS, "held pieces")
    world_size = bucket(len(pieces), WORLD_BUCKETS, "obstacle pieces")
    first_held = robot.body_count
    first_world = first_held + held_size

    held_row = _Row("held", frozenset({"held"}), robot.arm.dof, held_pose)
    rows = _robot_rows(robot)
    rows += _padded([held_row] * len(held), held_row._replace(name=""), held_size)
    world_rows = [
        _Row(obstacle.body.name, frozenset({obstacle.body.name, "world"}), 0, obstacle.pose) for _, obstacle in pieces
    ]
    rows += _padded(world_rows, _Row("", frozenset(), 0), world_size)

    filler = ConvexBody.box((0.01, 0.01, 0.01))
    held_bodies = _padded([piece.thinned(MAX_VERTICES) for piece in held], filler, held_size)
    world_bodies = _padded([piece for piece, _ in pieces], filler, world_size)
    own = robot_bodies(robot)
    bodies = ConvexBody.concatenate([own, ConvexBody.stack([*held_bodies, *world_bodies])])
    bodies = bodies.padded_to(vertices=max(MAX_VERTICES, own.vertices.shape[-2]))

    world, carried = range(first_world, first_world + len(pieces)), range(first_held, first_held + len(held))
    listed = [(a, b, margin_world) for a in range(first_held) if rows[a].mover > 0 for b in world]
    listed += [(int(a), int(b), margin_self) for a, b in np.asarray(robot.self_pairs)]
    listed += [(a, b, margin_held) for a in carried for b in world]
    # The last link carries the gripper and is as near to the held body as the palm is: the grasp decides that pair.
    links = range(robot.links.batch_size)
    listed += [(a, b, margin_held) for a in links if rows[a].mover < robot.arm.dof for b in carried]
    kept = _overridden(listed, [row.groups for row in rows], overrides or {})

    size = PAIR_BUCKET * max(1, -(-len(kept) // PAIR_BUCKET))
    # The padding is some pair of different bodies, never looked at.
    kept_or_filler = _padded(kept, (0, first_held, 0.0), size)
    pairs = np.array([(a, b) for a, b, _ in kept_or_filler], np.int32)
    arrays = CollisionArrays(
        robot=robot,
        bodies=jax.tree.map(jnp.asarray, bodies),
        local_poses=jnp.asarray(np.array([row.pose for row in rows], float)),
        held=jnp.arange(first_held, first_world),
        mover=jnp.asarray(np.array([row.mover for row in rows])),
        boxes=jax.tree.map(jnp.asarray, core_boxes(bodies)),
        pairs=jnp.asarray(pairs),
        margin=jnp.asarray(np.array([margin for _, _, margin in kept_or_filler])),
        valid=jnp.asarray(np.arange(size) < len(kept)),
    )
    return CollisionModel(arrays, tuple(row.name for row in rows), pairs)


def _padded[Item](items: Sequence[Item], filler: Item, size: int) -> list[Item]:
    return [*items, *[filler] * (size - len(items))]


def _overridden(
    listed: Iterable[tuple[int, int, float]],
    groups: Sequence[frozenset[str]],
    overrides: Mapping[tuple[str, str], float | None],
) -> list[tuple[int, int, float]]:
    known = frozenset[str]().union(*groups) | {"world", "held"}
    for name in (name for pair in overrides for name in pair):
        if name not in known:
            raise ValueError(f"collision override names {name!r}, which is unknown; known names are {sorted(known)}")
    kept: list[tuple[int, int, float]] = []
    for a, b, margin in listed:
        needed: float | None = margin
        for (one, two), value in overrides.items():
            if (one in groups[a] and two in groups[b]) or (one in groups[b] and two in groups[a]):
                needed = value
        if needed is not None:
            kept.append((a, b, needed))
    return kept


def body_frames(arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""]) -> Float[Array, "M 7"]:
    """World poses (M, 7) of all bodies, metres, at arm configuration q (n,) radians and finger coordinate θ."""
    robot = body_poses(arrays.robot, q, theta)
    # The frame of a palm body is the gripper frame.
    hand = jaxlie.SE3(robot[arrays.robot.links.batch_size])
    start, stop = robot.shape[0], robot.shape[0] + arrays.held.shape[0]
    held = (hand @ jaxlie.SE3(arrays.local_poses[start:stop])).wxyz_xyz
    return jnp.concatenate([robot, held, arrays.local_poses[stop:]])
