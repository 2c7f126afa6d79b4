"""Drops in MuJoCo."""

from __future__ import annotations

import numpy as np
import pytest

from regrasp_bench.tables.drops import DropTable, RetreatingGripper
from regrasp_bench.tables.hulls import random_hull, stone_of
from regrasp_gym.objects import OBJECTS
from regrasp_planner import stable_poses as stab_pose
from regrasp_planner.placement.stab_pose import rotation_to

BOX = OBJECTS["004_sugar_box"]


def tilted(axis, angle, towards):
    return np.cos(angle) * np.asarray(axis, float) + np.sin(angle) * np.asarray(towards, float)


@pytest.fixture(scope="module")
def table():
    return DropTable(BOX)


def test_what_is_put_down_in_a_stable_pose_stays_there(table):
    landing = table.drop(rotation_to(np.array([0, 0, -1.0])), 0.002)
    assert landing.rested
    assert landing.settled_into([0, 0, -1.0])
    assert landing.angle_to([0, 0, -1.0]) < 0.01
    assert landing.seconds < 0.5


def test_a_box_falls_to_the_side_of_its_edge_that_it_is_let_go_on(table):
    balance = np.arctan(0.024 / 0.088)
    for share, down in ((0.8, [0, 0, -1.0]), (1.2, [1.0, 0, 0])):
        x = tilted([0, 0, -1.0], share * balance, [1.0, 0, 0])
        assert table.drop(rotation_to(x), 0.002).settled_into(down)


def test_drops_repeat_to_the_bit_whatever_was_dropped_before(table):
    x = tilted([0, 0, -1.0], 0.3, [0, 1.0, 0])
    first = table.drop(rotation_to(x), 0.01)
    table.drop(rotation_to(np.array([0, 1.0, 0])), 0.05)
    again = table.drop(rotation_to(x), 0.01)
    np.testing.assert_array_equal(first.down, again.down)
    assert first.seconds == again.seconds


def test_a_gripper_that_lets_go_beside_leaves_the_object_alone_and_one_below_takes_it_along():
    finger = np.array([[x, y, z] for x in (-0.005, 0.005) for y in (-0.005, 0.005) for z in (-0.03, 0.03)])
    side, off = np.array([0, 0.047 + 0.005, 0]), np.array([0, 0.02, 0])
    beside = RetreatingGripper((finger + side, finger - side), (off, -off), np.array([0, 0, 0.2]))
    x = tilted([0, 0, -1.0], 0.15, [1.0, 0, 0])
    free = DropTable(BOX, beside).drop(rotation_to(x), 0.002)
    assert free.settled_into([0, 0, -1.0])
    # A hook under the raised edge lifts it over as it goes up.
    hook = finger * [2, 8, 0.2] + np.array([-0.026, 0, -0.094])
    lifted = DropTable(BOX, RetreatingGripper((hook,), (np.zeros(3),), np.array([0, 0, 0.2]))).drop(
        rotation_to(x), 0.002
    )
    assert not lifted.settled_into([0, 0, -1.0])


def test_a_hull_of_many_vertices_is_dropped_as_it_is():
    """MuJoCo is not to simplify it: it lands on facets of the hull given."""
    rng = np.random.default_rng(5)
    thing = stone_of(0.05 * random_hull(rng, 200) * [1.0, 0.5, 0.7], "many")
    poses = stab_pose(thing.pieces[0], np.zeros(3))
    drop_table = DropTable(thing)
    for x in random_hull(rng, 5):
        landing = drop_table.drop(rotation_to(x), 0.002)
        assert min(landing.angle_to(direction) for direction in poses.directions) < 0.02
