"""The data of one grasp problem, eq. (1) and (4): target, gripper, and the union of the scenes' obstacles.

The obstacles of all scenes are brought into the frame of the target; a grasp found in their union holds in every scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from regrasp_planner.batching import bucket_size
from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp.grasp import GraspGenOptions
from regrasp_planner.robot.gripper import reduce_gripper
from regrasp_planner.robot.model import Gripper
from regrasp_planner.task import Body, Scene

OBSTACLE_BUCKETS = (16, 32, 64)
MAX_VERTICES = 64
FACETS = 128
PIECE_BUCKETS = (2, 4, 8, 16)
PART_BUCKETS = (3, 5, 9, 17)
FAR_AWAY = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e3])
"""Pose of the bodies that pad a batch of obstacles."""
NO_PLANE = np.array([0.0, 0.0, 1.0, 1e3])
"""A plane (n, b) that is far away from everything."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TargetModel:
    """The target of a grasp problem.

    Attributes:
        pieces: convex pieces, stacked and padded.
        center: (3,) centre of mass, metres.
        facets: (T, F, 4) planes (n, b) of the hull of each graspable part, n·x ≤ b inside; see `graspable_parts`.
    """

    pieces: ConvexBody
    center: Float[Array, " 3"]
    facets: Float[Array, "T F 4"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GripperModel:
    """The gripper of a grasp problem, reduced to few bodies; see `ReducedGripper`.

    Attributes:
        hand: convex hulls of palm, finger 0 and finger 1, stacked.
        pads: the two contact bodies, stacked.
        screws: (2, 6) of the fingers, see `Gripper`.
        width_axis: (3,) closing axis.
        theta_range: (2,) limits of θ.
        length: widest opening, metres: the problem's unit of length.
        travel: θ per metre that a finger moves.
    """

    hand: ConvexBody
    pads: ConvexBody
    screws: Float[Array, "2 6"]
    width_axis: Float[Array, " 3"]
    theta_range: Float[Array, " 2"]
    length: Float[Array, ""]
    travel: Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GraspProblem:
    """Arrays of problem (4): target, union of obstacles, and gripper.

    Attributes:
        target: the target in its own frame.
        gripper: the gripper in its own frame.
        obstacles: the obstacles' pieces, stacked and padded.
        obstacle_poses: (W, 7) their poses in the target's frame.
        part: index of the graspable part between the pads.
        grounds: (2, 4) planes (x, b) under the target at pick and at release: x points down, x·p ≤ b above the ground.
        depth: least depth of the grasp centre in the part, metres.
        margin: collision margin δ_col, metres.
    """

    target: TargetModel
    gripper: GripperModel
    obstacles: ConvexBody
    obstacle_poses: Float[Array, "W 7"]
    part: Int[Array, ""]
    grounds: Float[Array, "2 4"]
    depth: Float[Array, ""]
    margin: Float[Array, ""]


def union_obstacles(scenes: Sequence[Scene], radius: float) -> tuple[list[ConvexBody], Float[np.ndarray, "W 7"]]:
    """The union of the scenes' obstacles near the target, in its frame (Alg. 1, line 3).

    Args:
        scenes: scenes with the target's pose in each.
        radius: distance from the target's origin beyond which obstacles are left out, metres.

    Returns:
        Pieces of the obstacles, and their poses (W, 7) in the frame of the target.
    """
    pieces: list[ConvexBody] = []
    poses: list[np.ndarray] = []
    for scene in scenes:
        if not scene.obstacles:
            continue
        world = np.array([obstacle.pose for obstacle in scene.obstacles])
        turn = Rotation.from_quat(scene.target_pose[:4], scalar_first=True).inv()
        rotations = turn * Rotation.from_quat(world[:, :4], scalar_first=True)
        positions = turn.apply(world[:, 4:] - scene.target_pose[4:])
        placed = np.concatenate([rotations.as_quat(scalar_first=True), positions], axis=1)
        # The target's origin in the frame of each obstacle, where a box around each piece is cheap and tight enough for
        # boards and tables.
        origins = -rotations.inv().apply(positions)
        for obstacle, pose, origin in zip(scene.obstacles, placed, origins, strict=True):
            for piece in obstacle.body.pieces:
                vertices = piece.hull_vertices()
                nearest = np.clip(origin, vertices.min(axis=0), vertices.max(axis=0))
                if np.linalg.norm(nearest - origin) - float(piece.radius) <= radius:
                    pieces.append(piece)
                    poses.append(pose)
    return pieces, np.array(poses).reshape(-1, 7)


def graspable_parts(target: Body) -> list[Float[np.ndarray, "N 3"]]:
    """Vertices of each part that the gripper may close on: the convex pieces and, if several, their common hull."""
    pieces = [piece.hull_vertices() for piece in target.pieces]
    return pieces if len(pieces) == 1 else [*pieces, target.hull_vertices()]


def grasp_problem(target: Body, scenes: Sequence[Scene], gripper: Gripper, options: GraspGenOptions) -> GraspProblem:
    """Arrays of problem (4), padded so that scenes of similar size share one compiled program."""
    reduced = reduce_gripper(gripper)
    length = float(gripper.max_opening)
    size = float(np.linalg.norm(target.hull_vertices(), axis=1).max())
    corners = np.concatenate([reduced.hand[k].hull_vertices() for k in range(3)])
    radius = size + float(np.linalg.norm(corners, axis=1).max() + gripper.max_opening)
    obstacles, poses = union_obstacles(scenes, radius)
    padding = bucket_size(max(len(obstacles), 1), OBSTACLE_BUCKETS) - len(obstacles)
    obstacles += [ConvexBody.box((0.01, 0.01, 0.01))] * padding
    return GraspProblem(
        target=_target_model(target, options.sharpness),
        gripper=GripperModel(
            hand=reduced.hand.with_sharpness(options.sharpness),
            pads=reduced.pads.with_sharpness(options.sharpness),
            screws=jnp.asarray(gripper.screws),
            width_axis=jnp.asarray(gripper.width_axis),
            theta_range=jnp.asarray([gripper.lower, gripper.upper]),
            length=jnp.asarray(length),
            travel=jnp.asarray(reduced.travel),
        ),
        obstacles=_stacked(obstacles, options.sharpness),
        obstacle_poses=jnp.asarray(np.concatenate([poses, np.tile(FAR_AWAY, (padding, 1))])),
        part=jnp.asarray(0),
        grounds=jnp.asarray(np.tile(NO_PLANE, (2, 1))),
        depth=jnp.asarray(options.depth * reduced.tip_length),
        margin=jnp.asarray(options.margin * length),
    )


def _target_model(target: Body, sharpness: float) -> TargetModel:
    """The target, its last piece repeated up to a bucket so that one program serves targets of one and two pieces."""
    count = len(target.pieces)
    pieces = [*target.pieces, *[target.pieces[-1]] * (bucket_size(count, PIECE_BUCKETS) - count)]
    return TargetModel(
        pieces=_stacked(pieces, sharpness),
        center=jnp.asarray(target.center_of_mass, float),
        facets=jnp.asarray(_facet_planes(graspable_parts(target))),
    )


def _stacked(bodies: Sequence[ConvexBody], sharpness: float) -> ConvexBody:
    thinned = ConvexBody.stack([body.thinned(MAX_VERTICES) for body in bodies])
    return thinned.padded_to(vertices=MAX_VERTICES).with_sharpness(sharpness)


def _facet_planes(parts: Sequence[Float[np.ndarray, "N 3"]]) -> Float[np.ndarray, "T F 4"]:
    """Planes (n, b) of the parts' hulls, padded with planes that are far away."""
    planes = [hull_planes(part) for part in parts]
    count = bucket_size(max(map(len, planes)), (FACETS,))
    padded = np.tile(NO_PLANE, (bucket_size(len(parts), PART_BUCKETS), count, 1))
    for k, plane in enumerate(planes):
        padded[k, : len(plane)] = plane
    return padded
