"""What the planner is given: mistakes in a task are named."""

from dataclasses import replace

import numpy as np
import pytest

from regrasp_planner import Body, Reason, plan
from regrasp_planner.errors import TaskError
from regrasp_planner.task import check_task


def with_obstacles(task, *obstacles):
    """The task with other obstacles in both scenes."""
    return replace(task, pick=replace(task.pick, obstacles=obstacles), place=replace(task.place, obstacles=obstacles))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda task: replace(task, place=replace(task.place, target_pose=np.zeros(7))), "unit quaternion"),
        (lambda task: replace(task, place=replace(task.place, target_pose=np.full(7, np.nan))), "'place'"),
        (lambda task: replace(task, start=np.full(7, 9.0)), "'joint1'"),
        (lambda task: replace(task, start=np.zeros(3)), "shape"),
        (lambda task: replace(task, target=Body("ghost", (), np.zeros(3))), "'ghost'"),
    ],
)
def test_bad_tasks_are_failures_that_name_the_mistake(panda, flipped_task, spoil, message):
    found = plan(spoil(flipped_task), panda, "static")
    assert found.failure.reason is Reason.BAD_INPUT
    assert message in found.failure.message


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda task: replace(task, place=replace(task.place, obstacles=())), "differ in their obstacles"),
        (lambda task: with_obstacles(task, *2 * task.pick.obstacles), "'table'"),
        (lambda task: replace(task, supports=frozenset({"shelf"})), "'shelf'"),
        (lambda task: replace(task, target=replace(task.target, center_of_mass=np.zeros(2))), "centre of mass"),
        (lambda task: replace(task, release=replace(task.release, half_extents=np.zeros(2))), "half extents"),
    ],
)
def test_what_cannot_be_planned_is_refused(panda, flipped_task, spoil, message):
    with pytest.raises(TaskError, match=message):
        check_task(spoil(flipped_task), panda)


def test_a_good_task_passes(panda, flipped_task):
    check_task(flipped_task, panda)
