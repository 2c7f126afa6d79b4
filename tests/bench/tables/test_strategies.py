"""Trials of strategies."""

from __future__ import annotations

from dataclasses import replace
from itertools import count, islice

import gymnasium
import numpy as np
import pytest

import regrasp_gym
from regrasp_bench.tables.strategies import fingerprint


@pytest.mark.slow
def test_a_fingerprint_sees_every_motion() -> None:
    env = gymnasium.make("regrasp_gym/PandaYCB-v0")
    expert = regrasp_gym.PlannerExpert(env)

    def planned(seed: int) -> bool:
        env.reset(seed=seed)
        return expert.reset()

    seeds = islice(filter(planned, count()), 2)
    plans = [expert.plan for _ in seeds]
    assert planned(expert.env.scene.seed)
    (first, second), again = plans, expert.plan
    assert fingerprint(second) == fingerprint(again)
    assert fingerprint(second) != fingerprint(first)
    stage = first.stages[-1]
    k = next(i for i, segment in enumerate(stage.segments) if segment.trajectory is not None)
    trajectory = stage.segments[k].trajectory
    assert trajectory is not None
    positions = trajectory.positions.copy()
    positions[len(positions) // 2] = np.nextafter(positions[len(positions) // 2], np.inf)
    segments = list(stage.segments)
    segments[k] = replace(segments[k], trajectory=replace(trajectory, positions=positions))
    touched = replace(first, stages=(*first.stages[:-1], replace(stage, segments=tuple(segments))))
    assert fingerprint(first) != fingerprint(touched)
