"""The optimisation problem of GraspGen, eq. (1) and (4), and its solution from given starts by Algorithm 1.

The obstacles of all scenes are brought into the frame of the target, their union; a grasp found there holds in every
one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from regrasp_planner.batching import bucket_size
from regrasp_planner.geometry.distance import separation
from regrasp_planner.geometry.hull import hull_planes
from regrasp_planner.geometry.support import ConvexBody, support_value
from regrasp_planner.grasp.grasp import GraspGenOptions
from regrasp_planner.optim.augmented_lagrangian import Options, Stall, augmented_lagrangian
from regrasp_planner.optim.manifold import SE3, Euclidean, Product
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
class GraspProblem:
    """Arrays of one grasp problem: target pieces, union of obstacles, and the gripper reduced to few bodies.

    ``facets`` holds the planes (n, b) of the hull of each part of the target that a start may take, n·x ≤ b inside: its
    pieces, and their common hull if there are several; ``taken`` says which. ``hand`` stacks palm, finger 0 and
    finger 1 (the convex hull of each); ``pads`` the two contact bodies. ``grounds`` are planes (x, b) with downward
    normals x that the target stands on before and after, x·p ≤ b above them. ``travel`` is θ per metre that a finger
    moves.
    """

    pieces: ConvexBody
    center: Float[Array, " 3"]
    obstacles: ConvexBody
    obstacle_poses: Float[Array, "W 7"]
    hand: ConvexBody
    pads: ConvexBody
    screws: Float[Array, "2 6"]
    width_axis: Float[Array, " 3"]
    facets: Float[Array, "T F 4"]
    taken: Int[Array, ""]
    grounds: Float[Array, "2 4"]
    depth: Float[Array, ""]
    lower: Float[Array, ""]
    upper: Float[Array, ""]
    margin: Float[Array, ""]
    length: Float[Array, ""]
    travel: Float[Array, ""]


class Terms(NamedTuple):
    """Quality f, least clearance (metres), largest and total violation (gripper openings), and how far a finger has
    moved (gripper openings): θ in units of ``length * travel``."""

    quality: Float[Array, ""]
    clearance: Float[Array, ""]
    violation: Float[Array, ""]
    lacking: Float[Array, ""]
    closing: Float[Array, " 1"]


def union_obstacles(scenes: Sequence[Scene], reach: float) -> tuple[list[ConvexBody], Float[np.ndarray, "W 7"]]:
    """The union of the scenes' obstacles in the target's frame, without those out of reach (Alg. 1, line 3).

    Args:
        scenes: scenes with the target's pose in each.
        reach: radius about the target's origin beyond which no part of the gripper can be, metres.

    Returns:
        Pieces of the obstacles and their poses (W, 7) in the frame of the target.
    """
    pieces: list[ConvexBody] = []
    poses: list[np.ndarray] = []
    for scene in scenes:
        if not scene.obstacles:
            continue
        there = np.array([obstacle.pose for obstacle in scene.obstacles])
        turn = Rotation.from_quat(scene.target_pose[:4], scalar_first=True).inv()
        rotations = turn * Rotation.from_quat(there[:, :4], scalar_first=True)
        positions = turn.apply(there[:, 4:] - scene.target_pose[4:])
        placed = np.concatenate([rotations.as_quat(scalar_first=True), positions], axis=1)
        # The target's origin in the frame of each obstacle, and a box around each piece along that frame's axes: cheap
        # and tight enough for boards and tables.
        origins = -rotations.inv().apply(positions)
        for obstacle, pose, origin in zip(scene.obstacles, placed, origins, strict=True):
            for piece in obstacle.body.pieces:
                vertices = piece.hull_vertices()
                near = np.clip(origin, vertices.min(axis=0), vertices.max(axis=0))
                if np.linalg.norm(near - origin) - float(piece.radius) <= reach:
                    pieces.append(piece)
                    poses.append(pose)
    return pieces, np.array(poses).reshape(-1, 7)


def _terms(point: tuple[Array, Array], problem: GraspProblem) -> tuple[Array, Array, Array, Array]:
    """Quality f, contact distances (2,), clearances of the open gripper (P + 3W + 6,), limits of θ and depth (3,).

    ``point`` is the gripper pose in the target's frame and θ in units of ``problem.length * problem.travel``.
    """
    pose, scaled = point
    theta = scaled[0] * problem.length * problem.travel
    hand = jaxlie.SE3(pose)
    opened = jnp.minimum(theta + problem.margin * problem.travel, problem.upper)
    closed_fingers = (hand @ jaxlie.SE3.exp(theta * problem.screws)).wxyz_xyz
    open_fingers = (hand @ jaxlie.SE3.exp(opened * problem.screws)).wxyz_xyz
    links = jnp.concatenate([pose[None], open_fingers])

    n_pieces, n_obstacles = problem.pieces.batch_size, problem.obstacles.batch_size
    identity = jnp.broadcast_to(jaxlie.SE3.identity().wxyz_xyz, (n_pieces, 7))
    # One flat batch: pads against pieces, the palm against pieces, palm and fingers against obstacles.
    first = ConvexBody.concatenate([problem.hand, problem.pads])
    second = ConvexBody.concatenate([problem.pieces, problem.obstacles])
    first_poses = jnp.concatenate([links, closed_fingers])
    second_poses = jnp.concatenate([identity, problem.obstacle_poses])
    pieces, obstacles = np.arange(n_pieces), n_pieces + np.arange(n_obstacles)
    pairs = np.concatenate(
        [
            np.stack(np.meshgrid([3, 4], pieces, indexing="ij"), -1).reshape(-1, 2),
            np.stack(np.meshgrid([0], pieces, indexing="ij"), -1).reshape(-1, 2),
            np.stack(np.meshgrid([0, 1, 2], obstacles, indexing="ij"), -1).reshape(-1, 2),
        ]
    )
    a, b = pairs[:, 1], pairs[:, 0]
    of_pair = separation(second[a], second_poses[a], first[b], first_poses[b], thorough=False)
    touching = of_pair.distance[: 2 * n_pieces].reshape(2, n_pieces)
    piece = jax.lax.stop_gradient(jnp.argmin(touching, axis=1))
    contact = jnp.take_along_axis(touching, piece[:, None], axis=1)[:, 0]
    # Of palm and open fingers from the ground: in closed form, by their support functions.
    down = problem.grounds[:, None, :3]
    own = jax.vmap(lambda link, x: jaxlie.SO3(link[:4]).inverse() @ x)
    local = jax.vmap(lambda x: own(links, jnp.broadcast_to(x, (3, 3))))(problem.grounds[:, :3])
    lowest = jax.vmap(lambda x: support_value(problem.hand, x))(local) + (down * links[:, 4:]).sum(axis=-1)
    above = problem.grounds[:, None, 3] - lowest
    clearance = jnp.concatenate([of_pair.distance[2 * n_pieces :], above.reshape(-1)])

    # Contact normals and points of the touched pieces, differentiated through the argmin of the distance problem.
    touched = jnp.arange(2) * n_pieces + piece
    (x1, x2), (s1, s2) = of_pair.direction[touched], of_pair.point_a[touched]
    line = s1 - s2
    line = line / jnp.sqrt(line @ line + 1e-12)
    antipodal = -x1 @ x2 + x1 @ line
    palm_center = hand.apply(problem.hand[0].center)
    towards = problem.center - palm_center
    towards = towards / jnp.sqrt(towards @ towards + 1e-12)
    width_axis = hand.rotation().apply(problem.width_axis)
    alignment = -0.5 * (width_axis @ towards) ** 2
    limits = jnp.stack([theta - problem.lower, problem.upper - theta]) / problem.travel
    # Contact alone would be content with a fingertip on an edge, which holds no torque and survives no error of a
    # millimetre: the grasp centre has to lie deep in the part taken, but for the faces that the fingers press on.
    planes = problem.facets[problem.taken]
    aside = jnp.sqrt(jnp.maximum(1.0 - (planes[:, :3] @ width_axis) ** 2, 1e-6))
    inside = (planes[:, 3] - planes[:, :3] @ hand.translation() - problem.depth * aside).min()
    return antipodal + alignment, contact, clearance, jnp.append(limits, inside)


def grasp_objective(
    point: tuple[Float[Array, " 7"], Float[Array, " 1"]], problem: GraspProblem
) -> tuple[Float[Array, ""], Float[Array, " 2"], Float[Array, " I"]]:
    """Problem (4) at one grasp, as `augmented_lagrangian` takes it.

    Args:
        point: gripper pose in the target's frame, and how far a finger has moved in units of the gripper's opening.
        problem: from `grasp_problem`.

    Returns:
        −f; the pads' signed distances from the target (2,), to be zero; and clearances beyond δ_col, distances of θ
        from its limits, and the depth of the grasp centre in the target beyond the least one (I,), to be at least zero.
        All distances in units of the gripper's opening.
    """
    quality, contact, clearance, limits = _terms(point, problem)
    scale = 1.0 / problem.length
    return -quality, contact * scale, jnp.concatenate([clearance - problem.margin, limits]) * scale


@partial(jax.jit, static_argnames="length")
def refine(
    poses: Float[Array, "K 7"],
    thetas: Float[Array, "K 1"],
    taken: Int[Array, " K"],
    grounds: Float[Array, "K 2 4"],
    problem: GraspProblem,
    max_evaluations: int,
    *,
    length: float,
) -> tuple[Float[Array, "K 7"], Terms, Int[Array, " K"]]:
    """Augmented Lagrangian with the Riemannian trust region and BFGS (Alg. 1) from K starts in lockstep."""
    manifold = Product((SE3(length=length), Euclidean(1)))
    count = _clearances(problem)
    options = Options(
        max_evaluations,
        max_inner=6,
        constraint_tolerance=2e-3,
        gradient_tolerance=1e-3,
        stall=Stall(1e-3, 2),
        initial_penalty=20.0,
    )

    def one(pose: Array, theta: Array, part: Array, planes: Array) -> tuple[Array, Terms, Array]:
        result = augmented_lagrangian(
            grasp_objective,
            (pose, theta),
            manifold,
            options,
            params=replace(problem, taken=part, grounds=planes),
            counts=(2, count + 3),
        )
        terms = _rated(result.value, result.equalities, result.inequalities, result.point[1], problem)
        return result.point[0], terms, result.evaluations

    return jax.vmap(one)(poses, thetas, taken, grounds)


@jax.jit
def evaluate(
    poses: Float[Array, "K 7"], thetas: Float[Array, "K 1"], taken: Int[Array, " K"], problem: GraspProblem
) -> Terms:
    """What K grasps are worth as they are, without a ground and without derivatives."""

    def one(pose: Array, theta: Array, part: Array) -> Terms:
        here = replace(problem, taken=part)
        return _rated(*grasp_objective((pose, theta), here), theta, here)

    return jax.vmap(one)(poses, thetas, taken)


def _clearances(problem: GraspProblem) -> int:
    """How many of the inequalities are clearances: the first ones."""
    return problem.hand.batch_size * (problem.obstacles.batch_size + 2) + problem.pieces.batch_size


def _rated(value: Array, equalities: Array, inequalities: Array, theta: Array, problem: GraspProblem) -> Terms:
    clearance = inequalities[: _clearances(problem)].min() * problem.length + problem.margin
    violations = jnp.concatenate([jnp.abs(equalities), jnp.maximum(-inequalities, 0.0)])
    return Terms(-value, clearance, violations.max(), violations.sum(), theta)


def _repeated(pieces: Sequence[ConvexBody]) -> list[ConvexBody]:
    """The pieces, the last one repeated up to a bucket, so that one program serves targets of one and of two."""
    return [*pieces, *[pieces[-1]] * (bucket_size(len(pieces), PIECE_BUCKETS) - len(pieces))]


def graspable_parts(target: Body) -> list[Float[np.ndarray, "N 3"]]:
    """Vertices of what the gripper may close on: each convex piece, and where there are several, their common hull."""
    pieces = [piece.hull_vertices() for piece in target.pieces]
    return pieces if len(pieces) == 1 else [*pieces, target.hull_vertices()]


def _facet_planes(parts: Sequence[Float[np.ndarray, "N 3"]]) -> Float[np.ndarray, "T F 4"]:
    """Planes (n, b) of the parts' hulls, padded with planes that are far away."""
    planes = [hull_planes(part) for part in parts]
    count = bucket_size(max(map(len, planes)), (FACETS,))
    padded = np.tile(NO_PLANE, (bucket_size(len(parts), PART_BUCKETS), count, 1))
    for k, plane in enumerate(planes):
        padded[k, : len(plane)] = plane
    return padded


def grasp_problem(target: Body, scenes: Sequence[Scene], gripper: Gripper, options: GraspGenOptions) -> GraspProblem:
    """The arrays of one problem (4), padded so that scenes of similar size share one compiled program."""
    reduced = reduce_gripper(gripper)
    hull = target.hull_vertices()
    size = float(np.linalg.norm(hull, axis=1).max())
    corners = np.concatenate([reduced.hand[k].hull_vertices() for k in range(3)])
    reach = size + float(np.linalg.norm(corners, axis=1).max() + gripper.max_opening)
    bodies, poses = union_obstacles(scenes, reach)
    padding = bucket_size(max(len(bodies), 1), OBSTACLE_BUCKETS) - len(bodies)
    bodies = bodies + [ConvexBody.box((0.01, 0.01, 0.01))] * padding
    poses = np.concatenate([poses, np.tile(FAR_AWAY, (padding, 1))])
    pieces, obstacles = (
        ConvexBody.stack([piece.thinned(MAX_VERTICES) for piece in some]).padded_to(vertices=MAX_VERTICES)
        for some in (_repeated(target.pieces), bodies)
    )
    return GraspProblem(
        pieces=pieces.with_sharpness(options.sharpness),
        center=jnp.asarray(target.center_of_mass, float),
        obstacles=obstacles.with_sharpness(options.sharpness),
        obstacle_poses=jnp.asarray(poses),
        hand=reduced.hand.with_sharpness(options.sharpness),
        pads=reduced.pads.with_sharpness(options.sharpness),
        screws=jnp.asarray(gripper.screws),
        width_axis=jnp.asarray(gripper.width_axis),
        facets=jnp.asarray(_facet_planes(graspable_parts(target))),
        taken=jnp.asarray(0),
        grounds=jnp.asarray(np.tile(NO_PLANE, (2, 1))),
        depth=jnp.asarray(options.depth * reduced.tip_length),
        lower=jnp.asarray(gripper.lower),
        upper=jnp.asarray(gripper.upper),
        margin=jnp.asarray(options.margin * float(gripper.max_opening)),
        length=jnp.asarray(float(gripper.max_opening)),
        travel=jnp.asarray(reduced.travel),
    )
