"""Configurations of the arm at a grasp, one end of a stage."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.ik.ik_solve import solve_ik
from regrasp_planner.pose import Pose, rigid, wxyz_xyz
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.collision_models import CollisionModels


@dataclass(frozen=True)
class GraspIk:
    """Configurations that put the gripper on the target.

    Attributes:
        grasp: the grasp.
        target_pose: (7,) of the target, in the world.
        configurations: each (n,) radians, best first; empty on failure.
        constraint: on failure, the constraint that failed.
    """

    grasp: Grasp
    target_pose: Pose
    configurations: tuple[Float[np.ndarray, " n"], ...]
    constraint: str = ""


def solve_grasp_ik(
    models: CollisionModels,
    grasps: Sequence[Grasp],
    target_pose: Pose,
    reference: Float[np.ndarray, " n"],
    seed: int,
) -> list[GraspIk]:
    """IkSolve for several grasps of the target at one pose, in one batch.

    Args:
        models: robot and obstacles.
        grasps: K grasps.
        target_pose: (7,) of the target, in the world.
        reference: (n,) configuration to stay near, radians.
        seed: seed of the random starts.
    """
    targets = np.array([grasp.gripper_pose(target_pose) for grasp in grasps])
    openings = np.array([grasp.opening for grasp in grasps])
    count = models.options.solutions
    results = solve_ik(
        models.empty_handed(target_pose), targets, openings, reference=reference, max_solutions=count, seed=seed
    )
    return [
        GraspIk(grasp, target_pose, tuple(solution.q for solution in result.solutions), result.message)
        for grasp, result in zip(grasps, results, strict=True)
    ]


def with_flipped(grasps: Iterable[Grasp], robot: Robot) -> list[Grasp]:
    """Each grasp, followed by the same one with the fingers swapped: half a turn about the approach axis."""
    half_turn = rigid(np.concatenate([[0.0], np.asarray(robot.gripper.approach_axis), np.zeros(3)]))
    return [
        either for grasp in grasps for either in (grasp, replace(grasp, pose=wxyz_xyz(rigid(grasp.pose) * half_turn)))
    ]
