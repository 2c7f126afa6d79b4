"""Plans for lifting: a grasp from the planner, and a straight line up. One stage that neither lowers nor releases."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.ik.descent import descend_to_pose
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.robot.kinematics import forward_kinematics
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.failures import bad_input, most_advanced_failure, no_grasp, unreachable
from regrasp_planner.stages.grasp_ik import GraspIk, with_flipped
from regrasp_planner.stages.options import PlanOptions
from regrasp_planner.stages.plan import Failure, Plan, PlanStats, Segment, SegmentKind, Stage, StageKind, Strategy
from regrasp_planner.stages.search import StageSearch
from regrasp_planner.task import Task

_ITERATIONS = 60
"""Steps of the descent from the present configuration to a grasp."""

_ATTEMPTS = 12
"""Configurations of one batch of grasps whose motion is planned."""

_HOLDS = 3
"""How often the gripper presses once more at the top, 0.3 s each: a learner has to see what holding looks like."""

_KIND = StageKind.PICK_TO_PLACE


def plan_lift(
    task: Task, robot: Robot, seed: int = 0, options: PlanOptions | None = None, known_grasps: Sequence[Grasp] = ()
) -> Plan:
    """Plan to take the target and to raise it to the height of its pose in the place scene.

    Each grasp is considered as it was found and from above. The one that the gripper has to turn least for is
    preferred, so that like scenes have like plans.

    Args:
        task: the place scene's target pose is where the target is to be held.
        robot: arm, gripper and their bodies; its gripper opens about as wide as the Panda's.
        seed: seed of the random starts.
        options: see `PlanOptions`.
        known_grasps: grasps to try before any are generated.

    Returns:
        `Plan` of one stage, or one with ``failure`` set.
    """
    began = time.perf_counter()
    mistake = bad_input(task, robot)
    if mistake is not None:
        return Plan.of(mistake, Strategy.DIRECT, seed)
    options = options or PlanOptions()
    options = replace(options, motion=replace(options.motion, lift=(_height(task),)))
    stages = StageSearch(task, robot, seed, options)
    outcome = _lift(stages, known_grasps)
    stats = PlanStats(*stages.counts(), {**stages.clock.seconds, "total": time.perf_counter() - began})
    return Plan.of(outcome if isinstance(outcome, Failure) else (outcome,), Strategy.DIRECT, seed, stats)


def _lift(stages: StageSearch, known_grasps: Sequence[Grasp]) -> Stage | Failure:
    search = stages.grasp_search(stages.options.regrasp, stages.task.pick)
    found = (
        [way for each in batch for way in (_from_above(each.grasp, stages), each.grasp)]
        for batch in stages.clock.each("grasp_gen", search.grasps())
    )
    failure: Failure | None = None
    for batch in chain([known_grasps], found):
        for ik in _configurations(stages, batch)[:_ATTEMPTS]:
            stage = _stage(stages, ik)
            if isinstance(stage, Stage):
                return stage
            failure = most_advanced_failure(failure, stage)
    if failure is None and search.ordered:
        return unreachable(stages.task.target, _KIND)
    return failure or no_grasp(search, _KIND, stages.task.pick.name, stages.robot)


def _configurations(stages: StageSearch, batch: Sequence[Grasp]) -> list[GraspIk]:
    """Grasps with one configuration each; those come first for which the gripper, then the arm turns least.

    A configuration that a descent from the present one leads to comes before those of IkSolve: it changes with the
    target's pose as little as that does.
    """
    arm, start, pose = stages.robot.arm, np.asarray(stages.task.start), stages.task.pick.target_pose
    now = rigid(np.asarray(forward_kinematics(arm, jnp.asarray(start))[-1]))
    grasps = with_flipped(batch, stages.robot)
    found: list[tuple[bool, float, GraspIk]] = []
    for ik in stages.grasp_ik(grasps, pose) if grasps else ():
        goal = ik.grasp.gripper_pose(pose)
        turn = float((now.inv() * rigid(goal)).rotation.magnitude())
        near = descend_to_pose(arm, goal[None], start[None, None], 1, _ITERATIONS)
        if near.solved()[0, 0]:
            found.append((False, turn, replace(ik, configurations=(near.q[0, 0],))))
        for q in ik.configurations:
            found.append((True, turn + 0.1 * float(np.abs(q - start).max()), replace(ik, configurations=(q,))))
    return [ik for *_, ik in sorted(found, key=lambda each: each[:2])]


def _from_above(grasp: Grasp, stages: StageSearch) -> Grasp:
    """The same contacts, the gripper turned about the line through them until it comes as straight down as it can."""
    gripper = stages.robot.gripper
    approach, width = np.asarray(gripper.approach_axis), np.asarray(gripper.width_axis)
    world = rigid(grasp.gripper_pose(stages.task.pick.target_pose))
    down = world.inv().rotation.apply(np.array([0.0, 0.0, -1.0]))
    angle = np.arctan2(width @ np.cross(approach, down), approach @ down)
    turn = Rotation.from_rotvec(angle * width).as_quat(scalar_first=True)
    pose = wxyz_xyz(rigid(grasp.pose) * rigid(np.concatenate([turn, np.zeros(3)])))
    return replace(grasp, pose=pose)


def _stage(stages: StageSearch, ik: GraspIk) -> Stage | Failure:
    motions = stages.motion.pick_motions(_KIND, ik)
    motion = next(iter(motions), None)
    if motion is None:
        return motions.failure
    picked = stages.motion.pick_segments(_KIND, ik, motion, np.asarray(stages.task.start))
    if isinstance(picked, Failure):
        return picked
    hold = Segment(SegmentKind.CLOSE, None, float(stages.robot.gripper.lower), holding=True)
    raised = np.array(ik.target_pose, float)
    raised[6] += _height(stages.task)
    return Stage(_KIND, ik.grasp, ik.target_pose, raised, raised, (*picked, *[hold] * _HOLDS))


def _height(task: Task) -> float:
    """How far up; a target that is there already is still raised by a little."""
    return max(float(task.place.target_pose[6] - task.pick.target_pose[6]), 0.01)
