"""How far an episode came, told from states of the simulation that are set by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from regrasp_train.progress import HELD_STEPS, Milestone, Progress

HELD, LYING, TOUCHED, FALLING = (True, False), (False, True), (True, True), (False, False)


def watched(*contacts, success=False, speed=0.0):
    progress = Progress()
    for touched, supported in contacts:
        world = SimpleNamespace(
            target_contacts=lambda both=(touched, supported): both,
            target_velocity=np.array([speed, 0.0, 0.0, 0.0, 0.0, 0.0]),
        )
        scenario = SimpleNamespace(tolerance=SimpleNamespace(speed=0.01))
        progress.watch(SimpleNamespace(is_success=success, world=world, scenario=scenario))
    return progress.milestone


@pytest.mark.parametrize(
    ("contacts", "reached"),
    [
        ([LYING] * 5, Milestone.NOTHING),
        ([TOUCHED] * 5, Milestone.NOTHING),
        ([HELD] * (HELD_STEPS - 1) + [LYING] * 3, Milestone.NOTHING),
        ([HELD] * HELD_STEPS, Milestone.TAKEN),
        ([HELD] * HELD_STEPS + [FALLING] * 3, Milestone.TAKEN),
        ([HELD] * HELD_STEPS + [TOUCHED, LYING], Milestone.PUT_DOWN),
        (([HELD] * HELD_STEPS + [LYING]) * 2, Milestone.RETAKEN),
        ([LYING, HELD, LYING, HELD, LYING], Milestone.NOTHING),
    ],
)
def test_steps_in_order(contacts, reached):
    assert watched(*contacts) is reached


def test_a_target_that_slides_is_not_put_down():
    assert watched(*[HELD] * HELD_STEPS, LYING, speed=0.1) is Milestone.TAKEN


def test_success_is_the_last_step():
    assert watched(LYING, success=True) is Milestone.PLACED
    assert str(Milestone.RETAKEN) == "re-taken"
