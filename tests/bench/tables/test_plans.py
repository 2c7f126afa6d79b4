"""Plans are timed in processes of their own, beside another checkout's."""

from __future__ import annotations

from pathlib import Path

import pytest

import regrasp_gym
from regrasp_bench.tables.checkouts import Checkout
from regrasp_bench.tables.plans import compare
from regrasp_gym.errors import BenchError, OptionError

LIFT = "regrasp_gym/PandaYCBLift-v0"


def test_a_checkout_plans_in_a_process_of_its_own() -> None:
    here = Checkout.other(Path(regrasp_gym.__file__).parents[1])
    with here.server(LIFT) as server:
        assert server.startup["import"] > 0
        answer = server.plan(0, "repeated")
        assert server.age > answer["seconds"] > 0
    assert answer["success"]
    assert answer["stages"] == 1
    assert sum(answer["modules"].values()) <= answer["seconds"]


def test_a_process_that_dies_is_told_with_its_last_words() -> None:
    with pytest.raises(BenchError, match="NameNotFound"), Checkout.this().server("regrasp_gym/Nothing-v0"):
        pass


def test_another_folder_is_no_checkout(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="not a checkout"):
        Checkout.other(tmp_path)


def test_ratios_are_this_checkout_over_the_other() -> None:
    def side(success: bool, plan: float, grasps: float) -> dict:
        return {"success": success, "seconds": {"plan": plan, "grasp_gen": grasps}}

    trials = [
        [side(True, 1.0, 0.5), side(True, 2.0, 2.0)],
        [side(False, 3.0, 0.5), side(True, 4.0, 2.0)],
        [side(True, 2.0, 0.5), side(True, 8.0, 2.0)],
    ]
    figures = compare(trials)
    assert figures["success"] == [2, 3]
    assert figures["ratio_median"] == {"plan": 2.0 / 4.0, "grasp_gen": 0.25}
    assert figures["ratio_of_each_median"] == 0.5
    assert compare([]) == {}
