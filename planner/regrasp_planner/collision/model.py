"""Collision model shared by inverse kinematics and path planning: which bodies, which pairs, how far apart.

All bodies form one stacked list: robot bodies (numbered as in `Robot.self_pairs`), held pieces, world pieces. What is
to be checked is a list of index pairs into it, each with the margin it needs. Both lists are padded to bucket sizes,
so that one compiled program serves every scene.

Distances cost microseconds per pair, so pairs are culled first: each body's core lies in a box along its own axes, and
the gap of two such boxes, seen along the axes of either, is a rigorous lower bound of the distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from regrasp_planner.batching import bucket
from regrasp_planner.geometry.boxes import box_distance
from regrasp_planner.geometry.distance import separation
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.robot.kinematics import body_poses, forward_kinematics, robot_bodies
from regrasp_planner.robot.model import Robot
from regrasp_planner.task import Obstacle

MAX_VERTICES = 64
"""Bodies with more are thinned outwards (0.6 mm on a can): an arm needs no finer shapes, and time goes with them."""
WORLD_BUCKETS = (16, 32, 64, 128, 256)
HELD_BUCKETS = (1, 4, 16, 64)
PAIR_BUCKET = 256
IDENTITY = np.array([1.0, 0, 0, 0, 0, 0, 0])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CollisionArrays:
    """Bodies and pairs as arrays: R robot, H held and W world bodies, M = R + H + W, and P pairs, all padded.

    Attributes:
        robot: the robot; its bodies are the first R of ``bodies``.
        bodies: (M, V, 3) each in its own frame.
        local_poses: (M, 7) for held bodies the pose in the gripper frame, for world bodies the pose in the world.
        held: (H,) indices of the held bodies (its length is what jitted code takes H from).
        mover: (M,) number of the last joint that moves the body; 0 for what stands still.
        box_center, box_half: (M, 3) box of the body's core (without the sweep) along the axes of its frame, metres.
        pairs: (P, 2) indices of bodies.
        margin: (P,) distance the pair has to keep, metres; negative where some overlap is allowed.
        valid: (P,) false for padding.
    """

    robot: Robot
    bodies: ConvexBody
    local_poses: Float[Array, "M 7"]
    held: Int[Array, " H"]
    mover: Int[Array, " M"]
    box_center: Float[Array, "M 3"]
    box_half: Float[Array, "M 3"]
    pairs: Int[Array, "P 2"]
    margin: Float[Array, " P"]
    valid: Bool[Array, " P"]


@dataclass(frozen=True)
class CollisionModel:
    """A `CollisionArrays` with what only the host needs: names for messages.

    Attributes:
        arrays: what jitted functions take as an argument.
        body_names: (M,) "link3", "palm", "finger0", "held", or the obstacle's name; empty for padding.
        pairs: (P, 2) the pairs, on the host.
    """

    arrays: CollisionArrays
    body_names: tuple[str, ...]
    pairs: Int[np.ndarray, "P 2"]

    def moved(self, name: str, pose: Float[np.ndarray, " 7"]) -> CollisionModel:
        """The same model with one thing elsewhere, at a fraction of the cost of a new model.

        Args:
            name: "held", or the name of an obstacle.
            pose: (7,) of the held body in the gripper frame, or of the obstacle in the world.

        Raises:
            ValueError: the model has nothing of that name.
        """
        rows = [i for i, body in enumerate(self.body_names) if body == name]
        if not rows:
            raise ValueError(f"the collision model has nothing called {name!r}; it has {sorted({*self.body_names})}")
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
        robot_count = self.arrays.robot.links.batch_size + self.arrays.robot.gripper.palm.batch_size
        robot_count += self.arrays.robot.gripper.fingers.batch_size
        return "self collision" if max(a, b) < robot_count else "world collision"


def _group_names(robot: Robot) -> tuple[list[str], list[frozenset[str]]]:
    """Name of each robot body, and the group names it answers to."""
    names = [f"link{int(i)}" for i in np.asarray(robot.link_of)]
    groups = [frozenset({name, "arm"}) for name in names]
    names += ["palm"] * robot.gripper.palm.batch_size
    groups += [frozenset({"palm", "gripper"})] * robot.gripper.palm.batch_size
    for finger in np.asarray(robot.gripper.finger_of):
        names.append(f"finger{int(finger)}")
        groups.append(frozenset({names[-1], "fingers", "gripper"}))
    return names, groups


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
    """Everything the robot may hit.

    Checked are all robot bodies against all obstacles, ``robot.self_pairs``, held pieces against obstacles, and held
    pieces against the arm's links that are not next to the gripper.

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
        ValueError: an override names nothing, or there are too many bodies.
    """
    names, groups = _group_names(robot)
    stack = robot_bodies(robot)
    robot_count = stack.batch_size
    link_of = np.asarray(robot.link_of)
    mover = np.full(robot_count, robot.arm.dof)
    mover[: len(link_of)] = link_of

    pieces = [(piece.thinned(MAX_VERTICES), obstacle) for obstacle in obstacles for piece in obstacle.body.pieces]
    held_size = bucket(max(len(held), 1), HELD_BUCKETS, "held pieces")
    world_size = bucket(len(pieces), WORLD_BUCKETS, "obstacle pieces")
    dummy = ConvexBody.box((0.01, 0.01, 0.01))
    bodies = [
        *(piece.thinned(MAX_VERTICES) for piece in held),
        *[dummy] * (held_size - len(held)),
        *(p for p, _ in pieces),
    ]
    bodies += [dummy] * (world_size - len(pieces))
    local_poses = np.tile(IDENTITY, (robot_count + held_size + world_size, 1))
    local_poses[robot_count : robot_count + held_size] = np.asarray(held_pose, float)
    for i, (_, obstacle) in enumerate(pieces):
        local_poses[robot_count + held_size + i] = obstacle.pose

    names += ["held"] * len(held) + [""] * (held_size - len(held))
    names += [obstacle.body.name for _, obstacle in pieces] + [""] * (world_size - len(pieces))
    groups += [frozenset({"held"})] * held_size
    groups += [frozenset({obstacle.body.name, "world"}) for _, obstacle in pieces]
    groups += [frozenset[str]()] * (world_size - len(pieces))
    mover = np.concatenate([mover, np.full(held_size, robot.arm.dof), np.zeros(world_size, int)])

    world = range(robot_count + held_size, robot_count + held_size + len(pieces))
    carried = range(robot_count, robot_count + len(held))
    listed = [(a, b, margin_world) for a in range(robot_count) if mover[a] > 0 for b in world]
    listed += [(int(a), int(b), margin_self) for a, b in np.asarray(robot.self_pairs)]
    listed += [(a, b, margin_held) for a in carried for b in world]
    # The last link carries the gripper and is as near to the held body as the palm is: the grasp decides that pair.
    listed += [(a, b, margin_held) for a in range(len(link_of)) if mover[a] < robot.arm.dof for b in carried]
    kept = _overridden(listed, groups, overrides or {})

    everything = ConvexBody.concatenate([stack, ConvexBody.stack(bodies)])
    everything = everything.padded_to(vertices=max(MAX_VERTICES, stack.vertices.shape[-2]))
    corners = np.asarray(everything.vertices)
    low, high = corners.min(1), corners.max(1)

    size = PAIR_BUCKET * max(1, -(-len(kept) // PAIR_BUCKET))
    pairs, margin, valid = np.zeros((size, 2), np.int32), np.zeros(size), np.zeros(size, bool)
    pairs[:, 1] = robot_count  # padding: some pair of different bodies, never looked at
    for i, (a, b, needed) in enumerate(kept):
        pairs[i], margin[i], valid[i] = (a, b), needed, True
    arrays = CollisionArrays(
        robot=robot,
        bodies=jax.tree.map(jnp.asarray, everything),
        local_poses=jnp.asarray(local_poses),
        held=jnp.arange(robot_count, robot_count + held_size),
        mover=jnp.asarray(mover),
        box_center=jnp.asarray(0.5 * (low + high)),
        box_half=jnp.asarray(0.5 * (high - low)),
        pairs=jnp.asarray(pairs),
        margin=jnp.asarray(margin),
        valid=jnp.asarray(valid),
    )
    return CollisionModel(arrays, tuple(names), pairs)


def _overridden(
    listed: Iterable[tuple[int, int, float]],
    groups: Sequence[frozenset[str]],
    overrides: Mapping[tuple[str, str], float | None],
) -> list[tuple[int, int, float]]:
    known = frozenset[str]().union(*groups) | {"world", "held"}
    for name in (name for pair in overrides for name in pair):
        if name not in known:
            raise ValueError(f"collision override names {name!r}; known are {sorted(known)}")
    kept: list[tuple[int, int, float]] = []
    for a, b, margin in listed:
        needed: float | None = margin
        for (one, two), value in overrides.items():
            if (one in groups[a] and two in groups[b]) or (one in groups[b] and two in groups[a]):
                needed = value
        if needed is not None:
            kept.append((a, b, needed))
    return kept


def gripper_pairs(arrays: CollisionArrays) -> Bool[Array, " P"]:
    """Which pairs (P,) are settled by the gripper's pose alone: bodies fixed to it against bodies that stand still."""
    movers = arrays.mover[arrays.pairs]
    return (movers.max(-1) == arrays.robot.arm.dof) & (movers.min(-1) == 0)


def body_frames(arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""]) -> Float[Array, "M 7"]:
    """World poses of all bodies, (M, 7), for arm configuration q (n,) radians and finger coordinate θ."""
    robot = body_poses(arrays.robot, q, theta)
    # Palm bodies sit in the gripper frame itself.
    hand = jaxlie.SE3(robot[arrays.robot.links.batch_size])
    start, stop = robot.shape[0], robot.shape[0] + arrays.held.shape[0]
    held = (hand @ jaxlie.SE3(arrays.local_poses[start:stop])).wxyz_xyz
    return jnp.concatenate([robot, held, arrays.local_poses[stop:]])


def pair_bounds(arrays: CollisionArrays, poses: Float[Array, "*N M 7"]) -> Float[Array, "*N P"]:
    """Lower bounds (*N, P) of distance minus margin, metres, from the boxes of the bodies; +inf for padding.

    In the frame of A the box of B, turned, lies in a box with half sizes |R| h; the distance of the two boxes there,
    less both sweeps, is a lower bound, and so it is in the frame of B. The larger counts.

    Args:
        arrays: the model.
        poses: (*N, M, 7) from `body_frames`; give all configurations at once rather than under vmap.
    """
    # Configurations last: the picks by body are then copies of whole rows, and all else is elementwise.
    rows = jnp.moveaxis(poses.reshape(-1, *poses.shape[-2:]), 0, -1)
    w, x, y, z = (rows[:, i] for i in range(4))
    turn = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    local = arrays.box_center[:, :, None]
    center = [rows[:, 4 + i] + sum(turn[i][j] * local[:, j] for j in range(3)) for i in range(3)]
    a, b = arrays.pairs[:, 0], arrays.pairs[:, 1]
    shift = [center[i][b] - center[i][a] for i in range(3)]
    turn_a = [[turn[i][j][a] for j in range(3)] for i in range(3)]
    turn_b = [[turn[i][j][b] for j in range(3)] for i in range(3)]
    half_a, half_b = arrays.box_half[a][:, :, None], arrays.box_half[b][:, :, None]
    relative = [[jnp.abs(sum(turn_a[k][i] * turn_b[k][j] for k in range(3))) for j in range(3)] for i in range(3)]
    gap_a = [
        jnp.abs(sum(turn_a[k][i] * shift[k] for k in range(3)))
        - half_a[:, i]
        - sum(relative[i][j] * half_b[:, j] for j in range(3))
        for i in range(3)
    ]
    gap_b = [
        jnp.abs(sum(turn_b[k][j] * shift[k] for k in range(3)))
        - half_b[:, j]
        - sum(relative[i][j] * half_a[:, i] for i in range(3))
        for j in range(3)
    ]
    needed = (arrays.bodies.radius[a] + arrays.bodies.radius[b] + arrays.margin)[:, None]
    bound = jnp.maximum(box_distance(gap_a), box_distance(gap_b)) - needed
    bound = jnp.where(arrays.valid[:, None], bound, jnp.inf)
    return jnp.moveaxis(bound, -1, 0).reshape(*poses.shape[:-2], -1)


def nearest_pairs(
    arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""], count: int
) -> Int[Array, " count"]:
    """The ``count`` pairs with the smallest `pair_bounds`, nearest first."""
    return jax.lax.top_k(-pair_bounds(arrays, body_frames(arrays, q, theta)), count)[1]


def batch_clearances(
    arrays: CollisionArrays, q: Float[Array, "N n"], theta: Float[Array, " N"], pairs: Int[Array, "N K"]
) -> tuple[Float[Array, "N K"], Float[Array, "N K n"]]:
    """Distance minus margin of K pairs in each of N configurations, with derivatives by the joints.

    One flat `separation` call. Witness points are material points of their bodies (envelope theorem), so with contact
    normal x from A to B the derivative by joint i is x·(v_B − v_A) with v = a_i × (p − o_i) for the bodies it moves.

    Args:
        arrays: the model.
        q: (N, n) radians.
        theta: (N,) finger coordinates; no derivatives are given.
        pairs: (N, K) pair numbers. Padding pairs have clearance +1 m and derivative 0.

    Returns:
        (N, K) metres and (N, K, n) metres per radian.
    """
    n_conf, count = pairs.shape
    frames = jax.vmap(lambda angles: forward_kinematics(arrays.robot.arm, angles))(q)
    poses = jax.vmap(lambda angles, opening: body_frames(arrays, angles, opening))(q, theta)
    rows = jnp.repeat(jnp.arange(n_conf), count)
    flat = pairs.reshape(-1)
    a, b = arrays.pairs[flat, 0], arrays.pairs[flat, 1]
    apart = separation(arrays.bodies[a], poses[rows, a], arrays.bodies[b], poses[rows, b])

    joints = jaxlie.SO3(frames[:, 1:-1, :4])
    axes, origins = joints @ arrays.robot.arm.axes, frames[:, 1:-1, 4:]
    axes, origins, x = axes[rows], origins[rows], apart.direction[:, None, :]
    order = jnp.arange(1, arrays.robot.arm.dof + 1)

    def speed(point: Float[Array, "L 3"], body: Int[Array, " L"]) -> Float[Array, "L n"]:
        moving = arrays.mover[body][:, None] >= order
        return jnp.where(moving, (x * jnp.cross(axes, point[:, None, :] - origins)).sum(-1), 0.0)

    slope = speed(apart.point_b, b) - speed(apart.point_a, a)
    valid = arrays.valid[flat]
    value = jnp.where(valid, apart.distance - arrays.margin[flat], 1.0)
    slope = jnp.where(valid[:, None], slope, 0.0)
    return value.reshape(n_conf, count), slope.reshape(n_conf, count, -1)


def clearance_jacobian(
    arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""], pairs: Int[Array, " K"]
) -> tuple[Float[Array, " K"], Float[Array, "K n"]]:
    """`batch_clearances` of one configuration: (K,) metres and (K, n) metres per radian."""
    value, slope = batch_clearances(arrays, q[None], jnp.reshape(theta, (1,)), pairs[None])
    return value[0], slope[0]


def pair_clearances(
    arrays: CollisionArrays, q: Float[Array, " n"], theta: Float[Array, ""], pairs: Int[Array, " K"]
) -> Float[Array, " K"]:
    """Distance minus margin (K,) metres, differentiable once by q, forwards and backwards."""
    fixed = jax.lax.stop_gradient(q)
    value, slope = clearance_jacobian(arrays, fixed, jax.lax.stop_gradient(theta), pairs)
    return value + jax.lax.stop_gradient(slope) @ (q - fixed)
