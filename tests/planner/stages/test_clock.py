"""Time by module."""

import time

import pytest

from regrasp_planner.stages.clock import Clock


def test_times_of_a_module_add_up_after_errors_too():
    clock = Clock()

    def fail():
        with clock("ik"):
            time.sleep(0.01)
            raise ValueError("no")

    with clock("ik"):
        time.sleep(0.01)
    with pytest.raises(ValueError, match="no"):
        fail()
    assert list(clock.seconds) == ["ik"]
    assert 0.02 <= clock.seconds["ik"] < 1


def test_only_the_making_of_items_counts():
    def slow():
        for k in range(3):
            time.sleep(0.01)
            yield k

    clock = Clock()
    items = []
    for item in clock.each("grasps", slow()):
        items.append(item)
        time.sleep(0.1)
    assert items == [0, 1, 2]
    assert 0.03 <= clock.seconds["grasps"] < 0.3
