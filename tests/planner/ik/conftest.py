"""Poses, errors and a cluttered scene for the tests of inverse kinematics."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import collision_model
from regrasp_planner.robot.kinematics import forward_kinematics

_poses = jax.jit(jax.vmap(lambda arm, q: forward_kinematics(arm, q)[-1], in_axes=(None, 0)))


def _gripper_poses(arm, q):
    return np.asarray(_poses(arm, jnp.asarray(q)))


def _random_configurations(arm, count, seed):
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.dof))


def _pose_errors(arm, q, targets):
    apart = jaxlie.SE3(jnp.asarray(targets)).inverse() @ jaxlie.SE3(_poses(arm, jnp.asarray(q)))
    turn = 2 * np.arctan2(np.linalg.norm(apart.wxyz_xyz[:, 1:4], axis=1), np.abs(apart.wxyz_xyz[:, 0]))
    return np.linalg.norm(apart.translation(), axis=1), turn


@pytest.fixture(scope="session")
def gripper_poses():
    """Poses (N, 7) of the gripper, from an arm and configurations (N, n)."""
    return _gripper_poses


@pytest.fixture(scope="session")
def random_configurations():
    """Configurations (N, n) within the limits, from an arm, a count and a seed."""
    return _random_configurations


@pytest.fixture(scope="session")
def pose_errors():
    """Distances (m) and angles (rad) of the gripper from its targets, from an arm, configurations and the targets."""
    return _pose_errors


@pytest.fixture(scope="session")
def cluttered(panda, build):
    """A scene with walls, and configurations that are free in it but less than 2 cm from something."""
    walls = (
        build.box_obstacle("left wall", (0.6, 0.02, 0.8), (0.4, 0.45, 0.4)),
        build.box_obstacle("right wall", (0.6, 0.02, 0.8), (0.4, -0.45, 0.4)),
        build.box_obstacle("ceiling", (0.8, 1.0, 0.02), (0.4, 0, 0.95)),
    )
    model = collision_model(panda, (*build.shelf_scene(0, clutter=8), *walls), overrides={("link1", "table"): None})
    q = _random_configurations(panda.arm, 3072, seed=3)
    q = q[_gripper_poses(panda.arm, q)[:, 4] > 0.25]
    clearance = configuration_clearance(model, q, 0.03, cap=0.03).value
    tight = q[(clearance >= 0) & (clearance < 0.02)]
    assert len(tight) >= 16
    return model, tight
