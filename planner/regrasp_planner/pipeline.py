"""The pipeline: one grasp from pick to place if there is one, else regrasps in between (the paper's Fig. 2b)."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from regrasp_planner.errors import StrategyError
from regrasp_planner.grasp import Grasp
from regrasp_planner.regrasp import RegraspSearch
from regrasp_planner.robot import Robot
from regrasp_planner.sampling import sample_grasps
from regrasp_planner.scene import Task
from regrasp_planner.stage_search import PlanOptions, StageSearch, furthest
from regrasp_planner.stages import Failure, Plan, PlanStats, Reason, Stage, StageKind, Strategy
from regrasp_planner.task_check import check_task

SAMPLED_BATCH = 16
"""Sampled grasps that IkSolve looks at together."""


def plan(
    task: Task,
    robot: Robot,
    strategy: Strategy | str = Strategy.REPEATED,
    seed: int = 0,
    options: PlanOptions | None = None,
    known_grasps: Sequence[Grasp] = (),
) -> Plan:
    """Plan the task.

    Args:
        task: what to move, from where to where, among what.
        robot: arm, gripper and their bodies.
        strategy: see `Strategy`; a name does.
        seed: of the random starts; the same seed gives the same plan.
        options: see `PlanOptions`.
        known_grasps: grasps tried for the whole way before any are generated, such as those of an earlier plan.

    Returns:
        `Plan`, with ``failure`` set where there is none.

    Raises:
        StrategyError: unknown strategy.
    """
    names = [str(member) for member in Strategy]
    if strategy not in names:
        raise StrategyError(f"unknown strategy {strategy!r}; the strategies are {', '.join(names)}")
    strategy = Strategy(strategy)
    began = time.perf_counter()
    try:
        check_task(task, robot)
    except ValueError as error:
        return Plan(False, Failure(Reason.BAD_INPUT, "", "", str(error)), (), strategy, PlanStats(), seed)
    stages = StageSearch(task, robot, seed, options or PlanOptions())
    outcome = _stages(stages, strategy, known_grasps)
    seconds = {**stages.clock.seconds, "total": time.perf_counter() - began}
    stats = PlanStats(
        stages.sampled + sum(search.evaluations for search in stages.searches),
        sum(search.ordered for search in stages.searches),
        seconds,
    )
    if isinstance(outcome, Failure):
        return Plan(False, outcome, (), strategy, stats, seed)
    return Plan(True, None, outcome, strategy, stats, seed)


def _stages(stages: StageSearch, strategy: Strategy, known_grasps: Sequence[Grasp]) -> tuple[Stage, ...] | Failure:
    """What the strategy allows, the cheapest first."""
    outcome: tuple[Stage, ...] | Failure | None = None
    if known_grasps:
        outcome = _one_grasp(stages, iter([known_grasps]))
    if outcome is None or isinstance(outcome, Failure):
        outcome = _sampled(stages) if strategy is Strategy.SAMPLING else _direct(stages)
    if strategy in (Strategy.DIRECT, Strategy.SAMPLING):
        return outcome
    if not isinstance(outcome, Failure) or outcome.reason is Reason.TOO_WIDE:
        return outcome
    regrasps = RegraspSearch(stages)
    outcome = regrasps.once(tilted=False)
    if isinstance(outcome, Failure) and strategy is not Strategy.STATIC:
        outcome = _better(outcome, regrasps.once(tilted=True))
    if isinstance(outcome, Failure) and strategy is Strategy.REPEATED:
        outcome = _better(outcome, regrasps.repeated())
    return outcome


def _better(failure: Failure, outcome: tuple[Stage, ...] | Failure) -> tuple[Stage, ...] | Failure:
    return furthest(failure, outcome) if isinstance(outcome, Failure) else outcome


def _one_grasp(stages: StageSearch, batches: Iterator[Sequence[Grasp]]) -> tuple[Stage, ...] | Failure | None:
    """One stage from pick to place by one of the grasps; None if there are none."""
    task = stages.task
    outcome = stages.one_grasp(StageKind.PICK_TO_PLACE, task.pick, task.place, stages.goal, batches)
    return (outcome,) if isinstance(outcome, Stage) else outcome


def _direct(stages: StageSearch) -> tuple[Stage, ...] | Failure:
    search = stages.search(stages.task.pick, stages.task.place)
    batches = ([found.grasp for found in batch] for batch in stages.timed(search.grasps()))
    where = f"{stages.task.pick.name} and {stages.task.place.name}"
    return _one_grasp(stages, batches) or stages.no_grasp(StageKind.PICK_TO_PLACE, search, where)


def _sampled(stages: StageSearch) -> tuple[Stage, ...] | Failure:
    task, options = stages.task, stages.options.sampling
    scenes, gripper = (task.pick, task.place), stages.robot.gripper
    result = stages.clock.time("grasp_gen", lambda: sample_grasps(task.target, scenes, gripper, options, stages.seed))
    stages.sampled += result.evaluations
    size = SAMPLED_BATCH
    batches = (result.grasps[begin : begin + size] for begin in range(0, len(result.grasps), size))
    failure = Failure(
        Reason.TOO_WIDE if result.reason == "too wide" else Reason.NO_COMMON_GRASP,
        StageKind.PICK_TO_PLACE,
        result.reason,
        f"none of {result.evaluations} sampled grasps of {task.target.name!r} is feasible in pick and place",
    )
    return _one_grasp(stages, batches) or failure
