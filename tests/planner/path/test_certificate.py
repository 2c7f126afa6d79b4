"""The certificate of timed motions against exact distances by coal."""

import numpy as np

from regrasp_planner.collision.model import collision_model
from regrasp_planner.path.certificate import certify
from regrasp_planner.path.clearance import path_clearance
from regrasp_planner.path.space import ConfigurationSpace
from regrasp_planner.path.trajectory import Trajectory, interpolating_path, time_parametrize
from regrasp_planner.robot.kinematics import forward_kinematics

THETA = 0.03


def test_the_certificate_sees_a_thin_plate_between_two_samples(robot, build, paths):
    """Two samples far apart, both free, with a plate of one millimetre that the hand sweeps through."""
    home = np.asarray(robot.home)
    at = np.asarray(forward_kinematics(robot.arm, home))[-1][4:]
    model = collision_model(robot, [build.box_obstacle("plate", (0.3, 0.001, 0.3), at)])
    ends = np.stack([home - np.eye(7)[0] * 0.6, home + np.eye(7)[0] * 0.6])
    trajectory = Trajectory(np.array([0.0, 1.0]), ends, np.zeros((2, 7)))
    clearance = path_clearance(ConfigurationSpace(model, THETA))
    assert clearance.free(ends).all()
    collision, _ = certify(clearance, trajectory)
    assert collision is not None
    assert "plate" in model.describe(collision.pair)
    assert paths.ExactDistances(model).least(collision.configuration[None])[0] < 1e-3


def test_what_the_certificate_passes_is_free(robot, paths):
    """Random motions through a scene: where coal finds an overlap at fine steps, there is no certificate."""
    rng = np.random.default_rng(2)
    model = collision_model(robot, paths.crowded_shelf(1), overrides={("link1", "table"): None})
    oracle, clearance = paths.ExactDistances(model), path_clearance(ConfigurationSpace(model, THETA))
    verdicts = []
    for start in paths.free_configurations(robot, model, rng, 16):
        goal = np.clip(start + rng.normal(scale=0.6, size=7), robot.arm.lower, robot.arm.upper)
        path = interpolating_path(np.stack([start, goal]))
        trajectory = time_parametrize(path, robot.arm.max_velocity, robot.arm.max_acceleration)
        collision, nearest = certify(clearance, trajectory)
        least = oracle.least(trajectory.at(np.linspace(0, trajectory.duration, 80))).min()
        verdicts.append(collision is None)
        if collision is None:
            assert least > 0
            assert least <= nearest + 0.05
        else:
            assert oracle.least(collision.configuration[None])[0] < 2e-3
    assert 2 <= sum(verdicts) <= 14
