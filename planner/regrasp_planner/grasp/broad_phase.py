"""In which order GraspGen looks at its start grasps: by how far bounding boxes of gripper and obstacles overlap.

This is a broad phase: boxes overlap where the bodies need not, and no distance between bodies is computed. What it says
is used for the order alone; whether a grasp is feasible is for the evaluation of the grasp problem to find out.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from regrasp_planner.geometry.boxes import Boxes, bounding_boxes
from regrasp_planner.robot.gripper import reduce_gripper
from regrasp_planner.robot.model import Gripper

CHUNK = 256
"""Grasps looked at in one call of the compiled program."""


def overlaps(
    poses: Float[np.ndarray, "K 7"],
    opened: Float[np.ndarray, " K"],
    gripper: Gripper,
    obstacles: Boxes,
    obstacle_poses: Float[np.ndarray, "W 7"],
    margin: float,
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """How far boxes about palm and fingers overlap those about the obstacles, by the separating axis theorem.

    Args:
        poses: gripper poses in the frame the obstacles are given in.
        opened: finger coordinates.
        gripper: the gripper.
        obstacles: boxes about the W obstacles, in the obstacles' frames.
        obstacle_poses: the obstacles' poses.
        margin: gap below which boxes count as overlapping, metres.

    Returns:
        For each grasp the sum of the overlaps over all pairs, metres, 0 where every gap is at least ``margin``; and the
        least gap, metres, negative where boxes overlap.
    """
    hand = bounding_boxes(reduce_gripper(gripper).hand)
    # In single precision, which is plenty for an order and takes half the time.
    screws, hand, obstacles, where = jax.tree.map(
        lambda leaf: np.asarray(leaf, np.float32), (gripper.screws, hand, obstacles, obstacle_poses)
    )
    chunks = np.resize(np.arange(len(poses)), (-(-len(poses) // CHUNK), CHUNK))
    poses, opened = poses.astype(np.float32), opened.astype(np.float32)
    # All are dispatched before the first is waited for.
    found = [
        _overlaps(poses[chunk], opened[chunk], screws, hand, obstacles, where, np.float32(margin)) for chunk in chunks
    ]
    total, least = (np.concatenate([np.asarray(each[k], float) for each in found] or [[]]) for k in (0, 1))
    return total[: len(poses)], least[: len(poses)]


@jax.jit
def _overlaps(
    poses: Float[Array, "K 7"],
    opened: Float[Array, " K"],
    screws: Float[Array, "2 6"],
    hand: Boxes,
    obstacles: Boxes,
    obstacle_poses: Float[Array, "W 7"],
    margin: Float[Array, ""],
) -> tuple[Float[Array, " K"], Float[Array, " K"]]:
    turns = jaxlie.SO3(obstacle_poses[:, :4]).as_matrix()
    centers = jnp.einsum("wij,wj->wi", turns, obstacles.center) + obstacle_poses[:, 4:]

    def gaps(pose: Float[Array, " 7"], theta: Float[Array, ""]) -> Float[Array, "3 W"]:
        moved = jaxlie.SE3(pose) @ jaxlie.SE3.exp(theta * screws)
        parts = jaxlie.SE3(jnp.concatenate([pose[None], moved.wxyz_xyz]))
        own = parts.rotation().as_matrix()
        between = jnp.einsum("aki,wkj->awij", own, turns)
        shift = jnp.einsum("aki,awk->awi", own, centers - parts.apply(hand.center)[:, None])
        size = jnp.abs(between) + 1e-9
        of_hand = jnp.abs(shift) - hand.half[:, None] - jnp.einsum("awij,wj->awi", size, obstacles.half)
        across = jnp.abs(jnp.einsum("awi,awij->awj", shift, between))
        of_obstacle = across - obstacles.half - jnp.einsum("awij,ai->awj", size, hand.half)
        best = jnp.maximum(of_hand.max(axis=-1), of_obstacle.max(axis=-1))
        for i in range(3):
            for j in range(3):
                k, m, p, q = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                line = jnp.abs(shift[..., m] * between[..., k, j] - shift[..., k] * between[..., m, j])
                radii = hand.half[:, None, k] * size[..., m, j] + hand.half[:, None, m] * size[..., k, j]
                radii += obstacles.half[:, p] * size[..., i, q] + obstacles.half[:, q] * size[..., i, p]
                length = jnp.sqrt(jnp.maximum(1 - between[..., i, j] ** 2, 0.0))
                best = jnp.maximum(best, jnp.where(length > 1e-3, (line - radii) / jnp.maximum(length, 1e-3), -jnp.inf))
        return best

    gap = jax.vmap(gaps)(poses, opened)
    return jnp.maximum(margin - gap, 0.0).sum(axis=(1, 2)), gap.min(axis=(1, 2))
