"""Plans for lifting: a grasp from the planner, and a straight line up. One stage that neither lowers nor lets go."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.ik.descent import reach
from regrasp_planner.ik.ik_solve import POSITION_TOLERANCE, ROTATION_TOLERANCE
from regrasp_planner.pose import rigid, wxyz_xyz
from regrasp_planner.robot.kinematics import forward_kinematics
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.motion import no_path
from regrasp_planner.stages.plan import (
    Failure,
    Plan,
    PlanStats,
    Reason,
    Segment,
    SegmentKind,
    Stage,
    StageKind,
    Strategy,
)
from regrasp_planner.stages.search import PlanOptions, StageSearch, furthest
from regrasp_planner.stages.surroundings import Ends, flipped
from regrasp_planner.task import Task, check_task

_ITERATIONS = 60
"""Steps of the descent from the present configuration to a grasp."""

_ATTEMPTS = 12
"""Configurations whose motion is planned before more grasps are looked for, or none are."""

_HOLDS = 3
"""How often the gripper presses once more at the top, 0.3 s each: a learner has to see what holding looks like."""

_KIND = StageKind.PICK_TO_PLACE


def plan_lift(
    task: Task, robot: Robot, seed: int = 0, options: PlanOptions | None = None, known_grasps: Sequence[Grasp] = ()
) -> Plan:
    """Plan to take the target and to raise it to the height of its pose in the place scene.

    Each grasp is considered as it was found and from above. Of several it takes the one that the gripper has to
    turn least for, so that like scenes have like plans.

    Args:
        task: the place scene's target pose is where the target is to be held.
        robot: arm, gripper and their bodies; its gripper opens about as wide as the Panda's.
        seed: of the random starts.
        options: of the planner.
        known_grasps: grasps tried before any are generated.

    Returns:
        `Plan` of one stage, or one with ``failure`` set.
    """
    began = time.perf_counter()
    try:
        check_task(task, robot)
    except ValueError as error:
        failure = Failure(Reason.BAD_INPUT, "", "", str(error))
        return Plan(False, failure, (), Strategy.DIRECT, PlanStats(), seed)
    options = options or PlanOptions()
    options = replace(options, motion=replace(options.motion, lift=(_height(task),)))
    stages = StageSearch(task, robot, seed, options)
    outcome = _lift(stages, known_grasps)
    seconds = {**stages.clock.seconds, "total": time.perf_counter() - began}
    stats = PlanStats(*stages.counts(), seconds)
    if isinstance(outcome, Failure):
        return Plan(False, outcome, (), Strategy.DIRECT, stats, seed)
    return Plan(True, None, (outcome,), Strategy.DIRECT, stats, seed)


def _lift(stages: StageSearch, known_grasps: Sequence[Grasp]) -> Stage | Failure:
    search = stages.search(stages.options.regrasp, stages.task.pick)
    found = (
        [way for each in batch for way in (_from_above(each.grasp, stages), each.grasp)]
        for batch in stages.timed(search.grasps())
    )
    failure: Failure | None = None
    for batch in chain([known_grasps], found):
        for grasp, ends in _configurations(stages, batch)[:_ATTEMPTS]:
            stage = _stage(stages, grasp, ends)
            if isinstance(stage, Stage):
                return stage
            failure = furthest(failure, stage)
    if failure is None and search.ordered:
        return stages.unreachable(_KIND)
    return failure or stages.no_grasp(_KIND, search, stages.task.pick.name)


def _configurations(stages: StageSearch, batch: Sequence[Grasp]) -> list[tuple[Grasp, Ends]]:
    """Grasps with one configuration of the arm each; first those to which the gripper, then the arm turns least.

    Before those of IkSolve come the ones that a descent from the present configuration leads to: they change with the
    target's pose as little as that does.
    """
    arm, start, pose = stages.robot.arm, np.asarray(stages.task.start), stages.task.pick.target_pose
    now = rigid(np.asarray(forward_kinematics(arm, jnp.asarray(start))[-1]))
    grasps = [either for grasp in batch for either in (grasp, flipped(grasp, stages.robot))]
    found: list[tuple[bool, float, Grasp, Ends]] = []
    for grasp, ends in zip(grasps, stages.ends(grasps, pose) if grasps else (), strict=True):
        goal = grasp.gripper_pose(pose)
        turn = float((now.inv() * rigid(goal)).rotation.magnitude())
        near = reach(arm, goal[None], start[None, None], np.asarray(1), np.asarray(_ITERATIONS))
        if near.position_error[0] < POSITION_TOLERANCE and near.rotation_error[0] < ROTATION_TOLERANCE:
            found.append((False, turn, grasp, Ends((np.asarray(near.q[0]),), "")))
        for q in ends.configurations:
            found.append((True, turn + 0.1 * float(np.abs(q - start).max()), grasp, Ends((q,), "")))
    return [(grasp, ends) for *_, grasp, ends in sorted(found, key=lambda each: each[:2])]


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


def _stage(stages: StageSearch, grasp: Grasp, ends: Ends) -> Stage | Failure:
    task = stages.task
    reaches = stages.motion.takes(_KIND, grasp, task.pick.target_pose, ends)
    way = next(iter(reaches), None)
    if way is None:
        return reaches.failure
    empty = stages.surroundings.empty_handed(task.pick.target_pose)
    start, closed = np.asarray(task.start), float(stages.robot.gripper.lower)
    transit = stages.motion.path(empty, start, way.inward.start, grasp.opening)
    if transit.trajectory is None:
        return no_path(_KIND, SegmentKind.TRANSIT, transit)
    segments = (
        Segment(SegmentKind.TRANSIT, transit.trajectory, grasp.opening, holding=False),
        Segment(SegmentKind.APPROACH, way.inward, grasp.opening, holding=False),
        Segment(SegmentKind.CLOSE, None, closed, holding=True),
        Segment(SegmentKind.LIFT, way.outward, closed, holding=True),
        *[Segment(SegmentKind.CLOSE, None, closed, holding=True)] * _HOLDS,
    )
    held = np.array(task.pick.target_pose, float)
    held[6] += _height(task)
    return Stage(_KIND, grasp, task.pick.target_pose, held, held, segments)


def _height(task: Task) -> float:
    """How far up; a target that is there already is still raised by a little."""
    return max(float(task.place.target_pose[6] - task.pick.target_pose[6]), 0.01)
