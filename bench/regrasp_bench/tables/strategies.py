"""Trials of the planner's strategies, where a trial of one strategy may tell the outcome of another."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import gymnasium
import numpy as np

import regrasp_gym
from regrasp_bench.tables.episodes import execute_episode, plan_episode
from regrasp_bench.tables.summary import completed
from regrasp_gym.errors import BenchError
from regrasp_gym.reports.files import read_lines
from regrasp_gym.reports.report import Record

if TYPE_CHECKING:
    from regrasp_planner import Plan

Strategy = Literal["sampling", "direct", "static", "nonstatic", "repeated"]
STRATEGIES: tuple[Strategy, ...] = ("sampling", "direct", "static", "nonstatic", "repeated")
"""Each contains those before it, but none contains "sampling", the baseline."""


def prepare(records: Path, setting: Record) -> Callable[[int], Record]:
    """The function that runs a trial of the setting's strategy.

    Args:
        records: file with trials of other strategies, from which outcomes are taken over where that is exact.
        setting: environment, strategy, and whether plans are executed.

    Raises:
        BenchError: the planner has no such strategy.
    """
    from regrasp_planner import Strategy as Known

    if setting["strategy"] not in list(Known):
        known = ", ".join(str(member) for member in Known)
        raise BenchError(f"the planner has no strategy {setting['strategy']!r}; it has {known}")
    env = gymnasium.make(setting["env"])
    expert = regrasp_gym.PlannerExpert(env, setting["strategy"])
    others = _of_other_strategies(read_lines(records), setting)

    def run(seed: int) -> Record:
        same_seed = [other for other in others if other["trial"] == seed]
        part = next((part for whole in same_seed if (part := _part_of(whole, setting))), None)
        if part is not None:
            return part
        record = plan_episode(env, expert, seed)
        if not (setting["execute"] and record["planned"]):
            return record | {"taken_over_from": ""}
        record["fingerprint"] = fingerprint(expert.plan)
        for other in same_seed:
            if other.get("fingerprint") == record["fingerprint"] and _as_planned(other):
                same = {key: other[key] for key in ("success", "steps", "plans", "cause", "detail")}
                return record | same | {"taken_over_from": other["setting"]["strategy"]}
        return record | execute_episode(env, expert) | {"taken_over_from": ""}

    return run


def _of_other_strategies(records: Sequence[Record], setting: Record) -> list[Record]:
    """Records of the same campaign by other strategies."""
    common = {key: value for key, value in setting.items() if key != "strategy"}
    return [
        record
        for record in completed(records)
        if record["setting"]["strategy"] != setting["strategy"]
        and common == {key: value for key, value in record["setting"].items() if key != "strategy"}
    ]


def _as_planned(record: Record) -> bool:
    """Whether the execution succeeded without an unforeseen plan.

    One plan is made before each stage. With more, something went wrong, and the plan made then depends on the strategy.
    """
    return bool(record.get("success")) and record["plans"] == len(record["stages"])


def _part_of(whole: Record, setting: Record) -> Record | None:
    """Outcome of the setting's strategy, from a trial of one that contains it; None if the record does not tell it.

    Both plan alike until the contained strategy is exhausted.
    """
    order = [phase["strategy"] for phase in whole["phases"]]
    strategy, containing = setting["strategy"], whole["setting"]["strategy"]
    if "sampling" in (strategy, *order) or STRATEGIES.index(strategy) > STRATEGIES.index(containing):
        return None
    # If its phase is missing, a strategy that it contains had found the plan.
    phase = whole["phases"][order.index(strategy)] if strategy in order else whole["phases"][-1]
    if phase["planned"] and setting["execute"] and not _as_planned(whole):
        return None
    outcome = {key: phase[key] for key in ("planned", "planning_seconds", "eval_grasp_calls", "ordered_starts")}
    if phase["planned"]:
        own = {key: value for key, value in whole.items() if key not in ("setting", "trial")}
        return own | outcome | {"taken_over_from": containing}
    kept = {key: whole[key] for key in ("seed", "target", "phases")}
    reason = {"stages": [], "seconds": {}, "cause": phase["cause"], "detail": phase["detail"]}
    return kept | outcome | reason | {"taken_over_from": containing}


def fingerprint(plan: Plan) -> str:
    """Digest of the motion of a plan. Plans with equal digests are executed alike."""
    digest = hashlib.sha256()
    for stage in plan.stages:
        digest.update(stage.kind.encode())
        for pose in (stage.grasp.pose, stage.start_pose, stage.release_pose, stage.settled_pose):
            digest.update(np.asarray(pose, float).tobytes())
        digest.update(np.array([stage.grasp.theta, stage.grasp.opening], float).tobytes())
        for segment in stage.segments:
            digest.update(f"{segment.kind} {segment.holding} {segment.theta!r}".encode())
            if segment.trajectory is not None:
                for array in (segment.trajectory.times, segment.trajectory.positions, segment.trajectory.velocities):
                    digest.update(np.ascontiguousarray(array, float).tobytes())
    return digest.hexdigest()
