"""GraspGen: force-closure grasps that are free of collision in several scenes at once (the paper's Alg. 1, eq. 1–4).

The obstacles of all scenes are brought into the frame of the target, their union; a grasp found there holds in every
one of them. Starts come from critical directions of the target's width function w(x) = h(x) + h(−x), whose support
points are antipodal; only the approach angle about the closing axis and the offset along it are left free. All starts
are evaluated once, and the augmented Lagrangian with the Riemannian trust region refines the most promising ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial.transform import Rotation

from regrasp_planner.geometry.distance import separation
from regrasp_planner.geometry.hull import bucket_size, qhull
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.grasp_starts import closing_axes, grasp_starts, reduce_gripper
from regrasp_planner.optim.augmented_lagrangian import augmented_lagrangian
from regrasp_planner.optim.manifold import SE3, Euclidean, Product
from regrasp_planner.pose import Pose, rigid, wxyz_xyz
from regrasp_planner.robot import Gripper
from regrasp_planner.scene import Body, Scene

OBSTACLE_BUCKETS = (16, 32, 64)
MAX_VERTICES = 48
FACETS = 128
PIECE_BUCKETS = (2, 4, 8)
FAR_AWAY = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e3])
"""Pose of the bodies that pad a batch of obstacles."""


@dataclass(frozen=True)
class Grasp:
    """A grasp X = (g_G, θ_G) of the target.

    Attributes:
        pose: (7,) gripper frame in the frame of the target.
        theta: finger coordinate at which both pads touch, in the gripper's unit.
        opening: finger coordinate of the open gripper around the target, before closing and after opening.
        quality: f = f_anti + f_align, at most 2.
        clearance: least signed distance of the open gripper from the obstacles of all scenes, and of its palm from the
            target, metres.
    """

    pose: Pose
    theta: float
    opening: float
    quality: float
    clearance: float

    def gripper_pose(self, target_pose: Pose) -> Pose:
        """Pose of the gripper (7,) in the world when the target is at ``target_pose``."""
        return wxyz_xyz(rigid(target_pose) * rigid(self.pose))


@dataclass(frozen=True)
class GraspGenOptions:
    """Options of `generate_grasps`.

    Attributes:
        margin: collision margin δ_col of the open gripper from obstacles, metres per metre of gripper opening, so
            that one value suits grippers of any size (0.06 is 5 mm for an 80 mm gripper).
        depth: how deep the grasp centre has to lie in the target, as a share of how far the fingers reach beyond it.
        quality_threshold: f_threshold of eq. (1).
        max_axes: closing axes taken from the width function.
        angles: approach angles about each closing axis.
        max_starts: starts evaluated at most.
        refined: starts refined by the augmented Lagrangian, the most promising of those.
        max_evaluations: evaluations spent on one refined start.
        sharpness: p of all bodies during the optimisation.
    """

    margin: float = 0.06
    depth: float = 0.5
    quality_threshold: float = 1.85
    max_axes: int = 12
    angles: int = 12
    max_starts: int = 144
    refined: int = 12
    max_evaluations: int = 16
    sharpness: int = 96


class GraspResult(NamedTuple):
    """Outcome of `generate_grasps`.

    Attributes:
        grasps: feasible grasps, best first (by quality and nearness to the centre of mass); empty if none was found.
        evaluations: evaluated grasps, every member of a batch counted (Table IV's eval-grasp calls).
        reason: why there is none: "too wide", "enclosed" or "poor quality"; "" if there is one.
    """

    grasps: tuple[Grasp, ...]
    evaluations: int
    reason: str


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GraspProblem:
    """Arrays of one grasp problem: target pieces, union of obstacles, and the gripper reduced to few bodies.

    ``facets`` holds the planes (n, b) of each piece's hull, n·x ≤ b inside. ``hand`` stacks palm, finger 0 and
    finger 1 (the convex hull of each); ``pads`` the two contact bodies.
    """

    pieces: ConvexBody
    center: Float[Array, " 3"]
    obstacles: ConvexBody
    obstacle_poses: Float[Array, "W 7"]
    hand: ConvexBody
    pads: ConvexBody
    screws: Float[Array, "2 6"]
    width_axis: Float[Array, " 3"]
    facets: Float[Array, "P F 4"]
    depth: Float[Array, ""]
    lower: Float[Array, ""]
    upper: Float[Array, ""]
    margin: Float[Array, ""]
    length: Float[Array, ""]


class _Terms(NamedTuple):
    """Quality f, least clearance (metres), largest and total violation (gripper openings), θ (gripper openings)."""

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
        turn = Rotation.from_quat(scene.target_pose[:4], scalar_first=True)
        for obstacle in scene.obstacles:
            rotation = turn.inv() * Rotation.from_quat(obstacle.pose[:4], scalar_first=True)
            position = turn.inv().apply(obstacle.pose[4:] - scene.target_pose[4:])
            for piece in obstacle.body.pieces:
                vertices = rotation.apply(piece.hull_vertices()) + position
                # A box around the piece, along the axes of the obstacle: cheap and tight enough for boards and tables.
                own = rotation.inv().apply(vertices)
                near = np.clip(np.zeros(3), own.min(0), own.max(0))
                if np.linalg.norm(near) - float(piece.radius) > reach:
                    continue
                pieces.append(piece)
                poses.append(np.concatenate([rotation.as_quat(scalar_first=True), position]))
    return pieces, np.array(poses).reshape(-1, 7)


def _terms(point: tuple[Array, Array], problem: GraspProblem) -> tuple[Array, Array, Array, Array]:
    """Quality f, contact distances (2,), clearances of the open gripper (P + 3W,), limits of θ and depth (3,).

    ``point`` is the gripper pose in the target's frame and θ in units of ``problem.length``.
    """
    pose, scaled = point
    theta = scaled[0] * problem.length
    hand = jaxlie.SE3(pose)
    opened = jnp.minimum(theta + problem.margin, problem.upper)
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
    clearance = of_pair.distance[2 * n_pieces :]

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
    limits = jnp.stack([theta - problem.lower, problem.upper - theta])
    # Contact alone would be content with a fingertip on an edge, which holds no torque and survives no error of a
    # millimetre: the grasp centre has to lie in the target.
    inside = (problem.facets[..., 3] - problem.facets[..., :3] @ hand.translation()).min(axis=1).max()
    return antipodal + alignment, contact, clearance, jnp.append(limits, inside - problem.depth)


def grasp_objective(
    point: tuple[Float[Array, " 7"], Float[Array, " 1"]], problem: GraspProblem
) -> tuple[Float[Array, ""], Float[Array, " 2"], Float[Array, " I"]]:
    """Problem (4) at one grasp, as `augmented_lagrangian` takes it.

    Args:
        point: gripper pose in the target's frame, and θ in units of the gripper's opening.
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
def _refine(
    poses: Float[Array, "K 7"],
    thetas: Float[Array, "K 1"],
    problem: GraspProblem,
    max_evaluations: int,
    *,
    length: float,
) -> tuple[Float[Array, "K 7"], _Terms, Int[Array, " K"]]:
    """Augmented Lagrangian with the Riemannian trust region and BFGS (Alg. 1) from K starts in lockstep.

    With one evaluation it tells what the starts are worth: the same program screens and refines.
    """
    manifold = Product((SE3(length=length), Euclidean(1)))

    def one(pose: Array, theta: Array) -> tuple[Array, _Terms, Array]:
        result = augmented_lagrangian(
            grasp_objective,
            (pose, theta),
            manifold,
            params=problem,
            counts=(2, problem.hand.batch_size * problem.obstacles.batch_size + problem.pieces.batch_size + 3),
            max_evaluations=max_evaluations,
            max_inner=6,
            constraint_tolerance=2e-3,
            gradient_tolerance=1e-3,
            initial_penalty=20.0,
            initial_radius=0.3,
            stall_decrease=1e-3,
            stall_steps=2,
        )
        count = problem.hand.batch_size * problem.obstacles.batch_size + problem.pieces.batch_size
        clearance = result.inequalities[:count].min() * problem.length + problem.margin
        lacking = jnp.abs(result.equalities).sum() + jnp.maximum(-result.inequalities, 0.0).sum()
        terms = _Terms(-result.value, clearance, result.violation, lacking, result.point[1])
        return result.point[0], terms, result.evaluations

    return jax.vmap(one)(poses, thetas)


def _repeated(pieces: Sequence[ConvexBody]) -> list[ConvexBody]:
    """The pieces, the last one repeated up to a bucket, so that one program serves targets of one and of two."""
    return [*pieces, *[pieces[-1]] * (bucket_size(len(pieces), PIECE_BUCKETS) - len(pieces))]


def _facet_planes(pieces: Sequence[ConvexBody]) -> Float[np.ndarray, "P F 4"]:
    """Planes (n, b) of the pieces' hulls, padded with planes that are far away."""
    planes = [qhull(piece.hull_vertices()).equations * [1.0, 1.0, 1.0, -1.0] for piece in pieces]
    size = bucket_size(max(len(plane) for plane in planes), (FACETS,))
    padded = np.tile([0.0, 0.0, 0.0, 1e3], (len(pieces), size, 1))
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
        facets=jnp.asarray(_facet_planes(_repeated(target.pieces))),
        depth=jnp.asarray(options.depth * reduced.tip_length),
        lower=jnp.asarray(gripper.lower),
        upper=jnp.asarray(gripper.upper),
        margin=jnp.asarray(options.margin * float(gripper.max_opening)),
        length=jnp.asarray(float(gripper.max_opening)),
    )


def generate_grasps(
    target: Body, scenes: Sequence[Scene], gripper: Gripper, options: GraspGenOptions | None = None
) -> GraspResult:
    """Grasps that hold the target and keep clear of the obstacles of all ``scenes`` (Alg. 1).

    Args:
        target: the body to take, convex pieces in its own frame.
        scenes: scenes the same grasp must be feasible in, such as pick and place.
        gripper: the two-finger gripper.
        options: see `GraspGenOptions`.

    Returns:
        `GraspResult`; without a feasible grasp it is empty and says why.
    """
    options = options or GraspGenOptions()
    length = float(gripper.max_opening)
    hull = target.hull_vertices()
    axes, _ = closing_axes(hull, length * (1 - 0.25 * options.margin), options.max_axes)
    if len(axes) == 0:
        return GraspResult((), 0, "too wide")
    problem = grasp_problem(target, scenes, gripper, options)
    poses, thetas = grasp_starts(hull, axes, gripper, options.angles, options.margin * length)
    taken = _evenly(len(poses), options.max_starts)
    poses, scaled = poses[taken], thetas[taken, None] / length
    merit = _screened(poses, scaled, problem, length, options.refined)
    chosen = np.resize(np.argsort(merit, kind="stable")[: options.refined], options.refined)
    refined, terms, spent = jax.device_get(
        _refine(poses[chosen], scaled[chosen], problem, options.max_evaluations, length=length)
    )
    evaluations = len(poses) + int(spent.sum())
    grasps = []
    contact_found = False
    for pose, quality, clearance, violation, theta in zip(
        refined, terms.quality, terms.clearance, terms.violation, terms.closing[:, 0] * length, strict=True
    ):
        if not np.isfinite(violation) or violation > 0.01:
            continue
        contact_found = True
        if quality < options.quality_threshold:
            continue
        opening = min(theta + options.margin * length, float(gripper.upper))
        grasps.append(Grasp(np.asarray(pose), float(theta), float(opening), float(quality), float(clearance)))
    if not grasps:
        return GraspResult((), evaluations, "poor quality" if contact_found else "enclosed")
    # A grasp near the centre of mass has less of a torque to hold: an opening's distance counts as 0.3 of quality.
    grasps.sort(
        key=lambda grasp: 0.3 * float(np.linalg.norm(grasp.pose[4:] - target.center_of_mass)) / length - grasp.quality
    )
    return GraspResult(tuple(_distinct(grasps, length)), evaluations, "")


def _evenly(count: int, limit: int) -> np.ndarray:
    """At most ``limit`` of ``count`` indices, evenly taken."""
    return np.arange(count) if count <= limit else np.linspace(0, count - 1, limit).round().astype(int)


def _screened(
    poses: np.ndarray, scaled: np.ndarray, problem: GraspProblem, length: float, batch: int
) -> Float[np.ndarray, " K"]:
    """How far each start is from a good grasp: its violations, less a little for its quality; one evaluation each."""
    merits: list[np.ndarray] = []
    for begin in range(0, len(poses), batch):
        taken = np.resize(np.arange(begin, min(begin + batch, len(poses))), batch)
        _, terms, _ = jax.device_get(_refine(poses[taken], scaled[taken], problem, 1, length=length))
        merits.append(terms.lacking - 0.2 * terms.quality)
    return np.concatenate(merits)[: len(poses)]


def _distinct(grasps: list[Grasp], length: float) -> list[Grasp]:
    kept: list[Grasp] = []
    for grasp in grasps:
        turn = Rotation.from_quat(grasp.pose[:4], scalar_first=True)
        for other in kept:
            angle = (turn.inv() * Rotation.from_quat(other.pose[:4], scalar_first=True)).magnitude()
            if angle < 0.05 and np.linalg.norm(grasp.pose[4:] - other.pose[4:]) < 0.05 * length:
                break
        else:
            kept.append(grasp)
    return kept
