"""The pipeline: one grasp from pick to place if there is one, else regrasps in between (the paper's Fig. 2b)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.grasp.sampling import sample_grasps
from regrasp_planner.robot.model import Robot
from regrasp_planner.stages.motion import PathObserver
from regrasp_planner.stages.plan import Failure, Phase, Plan, PlanStats, Reason, Stage, StageKind, Strategy
from regrasp_planner.stages.regrasp import RegraspSearch
from regrasp_planner.stages.scale import grown, scaled_grasp, shrink_factor, shrunk
from regrasp_planner.stages.search import PlanOptions, StageSearch, furthest
from regrasp_planner.task import Task, check_task

SAMPLED_BATCH = 16
"""Sampled grasps that IkSolve looks at together."""


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
        strategy: see `Strategy`; a name does.
        seed: of the random starts; the same seed gives the same plan.
        options: see `PlanOptions`; its lengths are for a gripper that opens 80 mm, and grow with the gripper.
        known_grasps: grasps tried for the whole way before any are generated, such as those of an earlier plan.
        observer: told of every path query and its result, such as to record them.

    Returns:
        `Plan`, with ``failure`` set where there is none.

    Raises:
        StrategyError: unknown strategy.
    """
    strategy = Strategy(strategy)
    began = time.perf_counter()
    try:
        check_task(task, robot)
    except ValueError as error:
        return Plan(False, Failure(Reason.BAD_INPUT, "", "", str(error)), (), strategy, PlanStats(), seed)
    factor = shrink_factor(robot)
    stages = StageSearch(*shrunk(task, robot), seed, options or PlanOptions(), observer)
    known_grasps = [scaled_grasp(grasp, factor) for grasp in known_grasps]
    phases: list[Phase] = []
    outcome: tuple[Stage, ...] | Failure | None = None
    for phase, attempt in _attempts(stages, strategy, known_grasps):
        found = attempt()
        outcome = _better(outcome, found) if isinstance(outcome, Failure) else found
        failure = outcome if isinstance(outcome, Failure) else None
        phases.append(Phase(phase, failure, *stages.counts(), time.perf_counter() - began))
        if failure is None or failure.reason is Reason.TOO_WIDE:
            break
    seconds = {**stages.clock.seconds, "total": time.perf_counter() - began}
    stats = PlanStats(*stages.counts(), seconds, tuple(phases))
    if isinstance(outcome, Failure):
        return Plan(False, outcome, (), strategy, stats, seed)
    assert outcome is not None
    return Plan(True, None, grown(outcome, factor), strategy, stats, seed)


_Attempt = Callable[[], tuple[Stage, ...] | Failure]


def _attempts(
    stages: StageSearch, strategy: Strategy, known_grasps: Sequence[Grasp]
) -> Iterator[tuple[Strategy, _Attempt]]:
    """What to try in turn, the cheapest first, each with the strategy that goes so far."""
    if strategy is Strategy.SAMPLING:
        yield strategy, lambda: _known(stages, known_grasps) or _sampled(stages)
        return
    yield Strategy.DIRECT, lambda: _known(stages, known_grasps) or _direct(stages)
    if strategy is Strategy.DIRECT:
        return
    regrasps = RegraspSearch(stages)
    yield Strategy.STATIC, lambda: regrasps.once(tilted=False)
    if strategy is Strategy.STATIC:
        return
    yield Strategy.NONSTATIC, lambda: regrasps.once(tilted=True)
    if strategy is Strategy.REPEATED:
        yield Strategy.REPEATED, regrasps.repeated


def _known(stages: StageSearch, grasps: Sequence[Grasp]) -> tuple[Stage, ...] | None:
    """One stage by one of the grasps that are known already."""
    outcome = _one_grasp(stages, iter([grasps])) if grasps else None
    return None if isinstance(outcome, Failure) else outcome


def _better(failure: Failure, outcome: tuple[Stage, ...] | Failure) -> tuple[Stage, ...] | Failure:
    return furthest(failure, outcome) if isinstance(outcome, Failure) else outcome


def _one_grasp(stages: StageSearch, batches: Iterator[Sequence[Grasp]]) -> tuple[Stage, ...] | Failure | None:
    """One stage from pick to place by one of the grasps; None if there are none."""
    task = stages.task
    outcome = stages.one_grasp(StageKind.PICK_TO_PLACE, task.pick, task.place, stages.goal, batches)
    return (outcome,) if isinstance(outcome, Stage) else outcome


def _direct(stages: StageSearch) -> tuple[Stage, ...] | Failure:
    search = stages.search(stages.options.grasp, stages.task.pick, stages.task.place)
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
