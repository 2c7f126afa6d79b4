"""Margins along a path, and their relief at its ends."""

import numpy as np
import pytest

from regrasp_planner.collision.model import collision_model
from regrasp_planner.path.clearance import RELIEF_SLOPE, path_clearance
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.robot.kinematics import forward_kinematics

THETA = 0.03


@pytest.fixture(scope="module")
def near_crate(robot, build):
    """A space with a crate 2 cm beside the gripper at home, which keeps a margin of 5 cm."""
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    crate = build.box_obstacle("crate", (0.1, 0.1, 0.1), at + np.array([0.10, 0, 0]))
    return ConfigurationSpace(collision_model(robot, [crate], margin_world=0.05), THETA)


def test_free_configurations_keep_every_required_distance(robot, paths):
    model = collision_model(robot, paths.crowded_shelf(0), overrides={("link1", "table"): None})
    clearance = path_clearance(ConfigurationSpace(model, THETA))
    q = np.random.default_rng(0).uniform(robot.arm.lower, robot.arm.upper, (200, 7))
    required = clearance.required(q)
    found = clearance.measure(q, required)
    short = found.distance < required[found.sample, found.pair]
    expected = np.ones(len(q), bool)
    expected[found.sample[short]] = False
    assert 0.02 < expected.mean() < 0.98
    np.testing.assert_array_equal(clearance.free(q), expected)


def test_gradients_are_those_of_the_distances(robot, near_crate):
    clearance, q = path_clearance(near_crate), np.asarray(robot.home)[None] + 0.02
    found = clearance.measure(q, clearance.margin)
    assert len(found.pair)
    step = 1e-5 * np.random.default_rng(0).normal(size=7)
    at = [clearance.pairs.bounds(q + sign * step) for sign in (1, -1)]
    ahead, behind = (clearance.pairs.measure(each, found.sample, found.pair).distance for each in at)
    np.testing.assert_allclose(found.gradient @ step * 2, ahead - behind, atol=1e-8)


def test_a_margin_that_an_end_does_not_keep_is_relieved_there_and_grows_back(robot, near_crate):
    start = np.asarray(robot.home)
    goal = start + 1.2 * np.eye(7)[0]
    clearance = path_clearance(near_crate)
    assert not clearance.free(start[None])[0]
    relieved = clearance.between(start, goal)
    assert relieved.free(np.stack([start, goal])).all()
    step = 0.1 * np.eye(7)[0]
    required = relieved.required(np.stack([start, start + step, goal]))
    pairs = np.flatnonzero(required[0] < clearance.margin)
    assert {"crate"} <= {name for pair in pairs for name in near_crate.model.describe(int(pair)).split(" – ")}
    grown = np.minimum(required[0] + 0.1 * RELIEF_SLOPE, clearance.margin)
    np.testing.assert_allclose(required[1][pairs], grown[pairs], atol=1e-12)
    np.testing.assert_array_equal(required[2], clearance.margin)


def test_overlaps_are_reported_beyond_what_is_allowed(robot, build):
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [build.box_obstacle("crate", (0.1, 0.1, 0.1), at)])
    clearance = path_clearance(ConfigurationSpace(model, THETA))
    collision = clearance.deepest_overlap(home[None])
    assert collision is not None
    assert "crate" in model.describe(collision.pair)
    assert clearance.deepest_overlap(home[None], -collision.distance + 1e-3) is None
