"""The pipeline: one grasp from pick to place if there is one, otherwise regrasps in between (the paper's Fig. 2b)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.direct import plan_direct, plan_known, plan_sampled
from regrasp_planner.stages.failures import bad_input, most_advanced_failure
from regrasp_planner.stages.motion import PathObserver
from regrasp_planner.stages.options import PlanOptions
from regrasp_planner.stages.plan import Failure, Outcome, Phase, Plan, PlanStats, Reason, Strategy
from regrasp_planner.stages.regrasp import RegraspSearch
from regrasp_planner.stages.scale import planner_scale, scaled_grasp, to_metres, to_planner_scale
from regrasp_planner.stages.search import StageSearch
from regrasp_planner.task import Task


def plan(
    task: Task,
    robot: Robot,
    strategy: Strategy | str = Strategy.REPEATED,
    seed: int = 0,
    options: PlanOptions | None = None,
    known_grasps: Sequence[Grasp] = (),
    observer: PathObserver | None = None,
) -> Plan:
    """Plan the task.

    Args:
        task: what to move, from where to where, among what.
        robot: arm, gripper and their bodies.
        strategy: a `Strategy` or its name.
        seed: seed of the random starts; the same seed gives the same plan.
        options: see `PlanOptions`; its lengths are for a gripper that opens 80 mm, and scale with the gripper.
        known_grasps: grasps to try from pick to place before any are generated, such as those of an earlier plan.
        observer: told of every path query and its result.

    Returns:
        `Plan`, with ``failure`` set if there is none.

    Raises:
        StrategyError: unknown strategy.
    """
    strategy = Strategy(strategy)
    began = time.perf_counter()
    mistake = bad_input(task, robot)
    if mistake is not None:
        return Plan.of(mistake, strategy, seed)
    factor = planner_scale(robot)
    stages = StageSearch(*to_planner_scale(task, robot), seed, options or PlanOptions(), observer)
    known_grasps = [scaled_grasp(grasp, factor) for grasp in known_grasps]
    phases: list[Phase] = []
    failure: Failure | None = None
    outcome: Outcome | None = None
    for phase, attempt in _attempts(stages, strategy, known_grasps):
        outcome = attempt()
        failure = most_advanced_failure(failure, outcome) if isinstance(outcome, Failure) else None
        phases.append(Phase(phase, failure, *stages.counts(), time.perf_counter() - began))
        if failure is None or failure.reason is Reason.TOO_WIDE:
            break
    seconds = {**stages.clock.seconds, "total": time.perf_counter() - began}
    stats = PlanStats(*stages.counts(), seconds, tuple(phases))
    assert outcome is not None
    outcome = failure or outcome
    return Plan.of(outcome if isinstance(outcome, Failure) else to_metres(outcome, factor), strategy, seed, stats)


_Attempt = Callable[[], Outcome]


def _attempts(
    stages: StageSearch, strategy: Strategy, known_grasps: Sequence[Grasp]
) -> Iterator[tuple[Strategy, _Attempt]]:
    """What the strategy allows, the cheapest first, each with the least strategy that allows it."""
    if strategy is Strategy.SAMPLING:
        yield strategy, lambda: plan_known(stages, known_grasps) or plan_sampled(stages)
        return
    yield Strategy.DIRECT, lambda: plan_known(stages, known_grasps) or plan_direct(stages)
    if strategy is Strategy.DIRECT:
        return
    regrasps = RegraspSearch(stages)
    yield Strategy.STATIC, lambda: regrasps.once(tilted=False)
    if strategy is Strategy.STATIC:
        return
    yield Strategy.NONSTATIC, lambda: regrasps.once(tilted=True)
    if strategy is Strategy.REPEATED:
        yield Strategy.REPEATED, regrasps.repeated
