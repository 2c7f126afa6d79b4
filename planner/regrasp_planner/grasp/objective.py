"""Objective and constraints of problem (4), scores of grasps, and refinement by Algorithm 1."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int

from regrasp_planner.geometry.distance import Separation, separation
from regrasp_planner.geometry.support import ConvexBody, support_value
from regrasp_planner.grasp.problem import GraspProblem
from regrasp_planner.optim.augmented_lagrangian import Options, Stall, augmented_lagrangian
from regrasp_planner.optim.manifold import SE3, Euclidean, Product


class GraspScore(NamedTuple):
    """Value of a grasp in problem (4).

    Attributes:
        quality: f.
        clearance: least clearance of the open gripper, metres.
        violation: largest violation of a constraint, gripper openings.
        total_violation: sum of all violations, gripper openings.
        scaled_theta: (1,) θ in units of ``length * travel``.
    """

    quality: Float[Array, ""]
    clearance: Float[Array, ""]
    violation: Float[Array, ""]
    total_violation: Float[Array, ""]
    scaled_theta: Float[Array, " 1"]

    def unstacked(self, count: int) -> list[GraspScore]:
        """The first ``count`` of several stacked scores."""
        return [GraspScore(*(leaf[k] for leaf in self)) for k in range(count)]


def _hand_poses(pose: Array, theta: Array, problem: GraspProblem) -> tuple[Array, Array]:
    """Poses of palm and open fingers (3, 7), and of the closed fingers (2, 7)."""
    hand, gripper = jaxlie.SE3(pose), problem.gripper
    opened = jnp.minimum(theta + problem.margin * gripper.travel, gripper.theta_range[1])
    closed_fingers = (hand @ jaxlie.SE3.exp(theta * gripper.screws)).wxyz_xyz
    open_fingers = (hand @ jaxlie.SE3.exp(opened * gripper.screws)).wxyz_xyz
    return jnp.concatenate([pose[None], open_fingers]), closed_fingers


def _separations(links: Array, closed_fingers: Array, problem: GraspProblem) -> Separation:
    """Pads against pieces (2P), the palm against pieces (P), palm and open fingers against obstacles (3W)."""
    n_pieces, n_obstacles = problem.target.pieces.batch_size, problem.obstacles.batch_size
    identity = jnp.broadcast_to(jaxlie.SE3.identity().wxyz_xyz, (n_pieces, 7))
    first = ConvexBody.concatenate([problem.gripper.hand, problem.gripper.pads])
    second = ConvexBody.concatenate([problem.target.pieces, problem.obstacles])
    first_poses = jnp.concatenate([links, closed_fingers])
    second_poses = jnp.concatenate([identity, problem.obstacle_poses])
    pieces, obstacles = np.arange(n_pieces), n_pieces + np.arange(n_obstacles)
    pairs = np.concatenate(
        [
            np.stack(np.meshgrid(bodies, others, indexing="ij"), -1).reshape(-1, 2)
            for bodies, others in (([3, 4], pieces), ([0], pieces), ([0, 1, 2], obstacles))
        ]
    )
    a, b = pairs[:, 1], pairs[:, 0]
    return separation(second[a], second_poses[a], first[b], first_poses[b], thorough=False)


def _ground_clearances(links: Array, problem: GraspProblem) -> Array:
    """Distances (6,) of palm and open fingers from both grounds, by their support functions."""
    down = problem.grounds[:, None, :3]
    own = jax.vmap(lambda link, x: jaxlie.SO3(link[:4]).inverse() @ x)
    local = jax.vmap(lambda x: own(links, jnp.broadcast_to(x, (3, 3))))(problem.grounds[:, :3])
    lowest = jax.vmap(lambda x: support_value(problem.gripper.hand, x))(local) + (down * links[:, 4:]).sum(axis=-1)
    return (problem.grounds[:, None, 3] - lowest).reshape(-1)


def _quality(hand: jaxlie.SE3, normals: Array, points: Array, problem: GraspProblem) -> Array:
    """f = f_anti + f_align of eq. (4), from the outward normals and the contact points (2, 3) of both pads."""
    (x1, x2), (s1, s2) = normals, points
    line = s1 - s2
    line = line / jnp.sqrt(line @ line + 1e-12)
    antipodal = -x1 @ x2 + x1 @ line
    palm_center = hand.apply(problem.gripper.hand[0].center)
    towards = problem.target.center - palm_center
    towards = towards / jnp.sqrt(towards @ towards + 1e-12)
    width_axis = hand.rotation().apply(problem.gripper.width_axis)
    return antipodal - 0.5 * (width_axis @ towards) ** 2


def _depth(hand: jaxlie.SE3, problem: GraspProblem) -> Array:
    """How much deeper than the least depth the grasp centre lies in the part, metres.

    Contact alone would accept a fingertip on an edge, which holds no torque and survives no error of a millimetre. The
    faces under the fingers do not count.
    """
    planes = problem.target.facets[problem.part]
    width_axis = hand.rotation().apply(problem.gripper.width_axis)
    aside = jnp.sqrt(jnp.maximum(1.0 - (planes[:, :3] @ width_axis) ** 2, 1e-6))
    return (planes[:, 3] - planes[:, :3] @ hand.translation() - problem.depth * aside).min()


def grasp_objective(
    point: tuple[Float[Array, " 7"], Float[Array, " 1"]], problem: GraspProblem
) -> tuple[Float[Array, ""], Float[Array, " 2"], Float[Array, " I"]]:
    """Problem (4) at one grasp, as `augmented_lagrangian` takes it.

    Args:
        point: gripper pose in the target's frame, and θ in units of ``length * travel`` of the gripper.
        problem: from `grasp_problem`.

    Returns:
        −f; signed distances of the pads from the target (2,), to be zero; and inequalities (I,), to be at least zero:
        clearances of the open gripper beyond δ_col, distances of θ from its limits, and the excess depth of the grasp
        centre. All distances are in gripper openings.
    """
    pose, scaled_theta = point
    gripper, hand = problem.gripper, jaxlie.SE3(pose)
    theta = scaled_theta[0] * gripper.length * gripper.travel
    links, closed_fingers = _hand_poses(pose, theta, problem)
    pairs, n_pieces = _separations(links, closed_fingers, problem), problem.target.pieces.batch_size
    touching = pairs.distance[: 2 * n_pieces].reshape(2, n_pieces)
    piece = jax.lax.stop_gradient(jnp.argmin(touching, axis=1))
    contact = jnp.take_along_axis(touching, piece[:, None], axis=1)[:, 0]
    clearance = jnp.concatenate([pairs.distance[2 * n_pieces :], _ground_clearances(links, problem)])
    # Contact normals and points of the touched pieces, differentiated through the argmin of the distance problem.
    touched = jnp.arange(2) * n_pieces + piece
    quality = _quality(hand, pairs.direction[touched], pairs.point_a[touched], problem)
    lower, upper = gripper.theta_range
    limits = jnp.append(jnp.stack([theta - lower, upper - theta]) / gripper.travel, _depth(hand, problem))
    scale = 1.0 / gripper.length
    return -quality, contact * scale, jnp.concatenate([clearance - problem.margin, limits]) * scale


@partial(jax.jit, static_argnames="length")
def refine(
    poses: Float[Array, "K 7"],
    scaled_thetas: Float[Array, "K 1"],
    parts: Int[Array, " K"],
    grounds: Float[Array, "K 2 4"],
    problem: GraspProblem,
    max_evaluations: int,
    *,
    length: float,
) -> tuple[Float[Array, "K 7"], GraspScore, Int[Array, " K"]]:
    """Augmented Lagrangian with the Riemannian trust region and BFGS (Alg. 1) from K starts in lockstep.

    Returns:
        Refined gripper poses, scores, and the number of evaluations of each.
    """
    manifold = Product((SE3(length=length), Euclidean(1)))
    count = _clearance_count(problem)
    options = Options(
        max_evaluations,
        max_inner=6,
        constraint_tolerance=2e-3,
        gradient_tolerance=1e-3,
        stall=Stall(1e-3, 2),
        initial_penalty=20.0,
    )

    def one(pose: Array, theta: Array, part: Array, planes: Array) -> tuple[Array, GraspScore, Array]:
        result = augmented_lagrangian(
            grasp_objective,
            (pose, theta),
            manifold,
            options,
            params=replace(problem, part=part, grounds=planes),
            counts=(2, count + 3),
        )
        score = _score(result.value, result.equalities, result.inequalities, result.point[1], problem)
        return result.point[0], score, result.evaluations

    return jax.vmap(one)(poses, scaled_thetas, parts, grounds)


@jax.jit
def evaluate(
    poses: Float[Array, "K 7"], scaled_thetas: Float[Array, "K 1"], parts: Int[Array, " K"], problem: GraspProblem
) -> GraspScore:
    """Scores of K grasps, without a ground and without derivatives."""

    def one(pose: Array, theta: Array, part: Array) -> GraspScore:
        here = replace(problem, part=part)
        return _score(*grasp_objective((pose, theta), here), theta, here)

    return jax.vmap(one)(poses, scaled_thetas, parts)


def _clearance_count(problem: GraspProblem) -> int:
    """Number of clearances, which are the first of the inequalities."""
    return problem.gripper.hand.batch_size * (problem.obstacles.batch_size + 2) + problem.target.pieces.batch_size


def _score(value: Array, equalities: Array, inequalities: Array, theta: Array, problem: GraspProblem) -> GraspScore:
    clearance = inequalities[: _clearance_count(problem)].min() * problem.gripper.length + problem.margin
    violations = jnp.concatenate([jnp.abs(equalities), jnp.maximum(-inequalities, 0.0)])
    return GraspScore(-value, clearance, violations.max(), violations.sum(), theta)
