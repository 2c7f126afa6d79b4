"""One stage from pick to place by one grasp: a known one, one from GraspGen, or a sampled one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from regrasp_planner.grasp.grasp import Grasp, NoGraspReason
from regrasp_planner.grasp.sampling import sample_grasps
from regrasp_planner.stages.failures import most_advanced_failure, no_grasp, unreachable
from regrasp_planner.stages.grasp_ik import GraspIk, with_flipped
from regrasp_planner.stages.plan import Failure, Outcome, Reason, Stage, StageKind
from regrasp_planner.stages.search import StageSearch

SAMPLED_BATCH = 16
"""Sampled grasps that IkSolve solves together."""

_KIND = StageKind.PICK_TO_PLACE


def plan_known(stages: StageSearch, grasps: Sequence[Grasp]) -> tuple[Stage, ...] | None:
    """One stage by one of the known grasps; None if none of them works."""
    outcome = _first_stage(stages, [grasps]) if grasps else None
    return None if isinstance(outcome, Failure) else outcome


def plan_direct(stages: StageSearch) -> Outcome:
    """One stage by a grasp from GraspGen that is feasible in both scenes."""
    task = stages.task
    search = stages.grasp_search(stages.options.grasp, task.pick, task.place)
    batches = ([found.grasp for found in batch] for batch in stages.clock.each("grasp_gen", search.grasps()))
    where = f"{task.pick.name} and {task.place.name}"
    return _first_stage(stages, batches) or no_grasp(search, _KIND, where, stages.robot)


def plan_sampled(stages: StageSearch) -> Outcome:
    """One stage by one of many random grasps (the baseline)."""
    task, options = stages.task, stages.options.sampling
    with stages.clock("grasp_gen"):
        result = sample_grasps(task.target, (task.pick, task.place), stages.robot.gripper, options, stages.seed)
    stages.sampled += result.evaluations
    size = SAMPLED_BATCH
    batches = (result.grasps[begin : begin + size] for begin in range(0, len(result.grasps), size))
    failure = Failure(
        Reason.TOO_WIDE if result.reason is NoGraspReason.TOO_WIDE else Reason.NO_COMMON_GRASP,
        _KIND,
        result.reason.value if result.reason else "",
        f"none of {result.evaluations} sampled grasps of {task.target.name!r} is feasible in pick and place",
    )
    return _first_stage(stages, batches) or failure


def _first_stage(stages: StageSearch, batches: Iterable[Sequence[Grasp]]) -> Outcome | None:
    """One stage by the first grasp whose motion works; None if there are no grasps."""
    motion, task = stages.motion, stages.task
    failure: Failure | None = None
    attempts = 0
    rejected: list[GraspIk] = []
    for batch in batches:
        for pick_ik, place_ik in _reachable_at_both(stages, with_flipped(batch, stages.robot), rejected):
            pick, place = motion.pick_motions(_KIND, pick_ik), motion.place_motions(_KIND, place_ik)
            stage = motion.connect(_KIND, pick, place, task.place.target_pose, task.start)
            if isinstance(stage, Stage):
                return (stage,)
            failure = most_advanced_failure(failure, stage)
            attempts += pick.any_feasible() and place.any_feasible()
            if attempts == stages.options.motion_attempts:
                return failure
    return unreachable(task.target, _KIND, rejected) if failure is None and rejected else failure


def _reachable_at_both(
    stages: StageSearch, grasps: Sequence[Grasp], rejected: list[GraspIk]
) -> Iterator[tuple[GraspIk, GraspIk]]:
    """Configurations at pick and place, for grasps that have both; the others are appended to ``rejected``."""
    picks = stages.grasp_ik(grasps, stages.task.pick.target_pose)
    reached = [pick for pick in picks if pick.configurations]
    places = stages.grasp_ik([pick.grasp for pick in reached], stages.goal) if reached else []
    rejected += [ik for ik in (*picks, *places) if not ik.configurations]
    yield from ((pick, place) for pick, place in zip(reached, places, strict=True) if place.configurations)
