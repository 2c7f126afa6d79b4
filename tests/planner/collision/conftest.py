"""A robot with a held box in front of a shelf, and random configurations of it."""

import numpy as np
import pytest

from regrasp_planner.collision.model import collision_model
from regrasp_planner.geometry.support import ConvexBody


@pytest.fixture(scope="module")
def model(panda, build):
    held_pose = build.pose((0, 0, 0.04))
    return collision_model(
        panda,
        build.shelf_scene(2),
        held=[ConvexBody.box((0.05, 0.06, 0.15))],
        held_pose=held_pose,
        overrides={("link1", "table"): None},
    )


@pytest.fixture(scope="module")
def random_configurations(model):
    """Function of a count and a seed that gives configurations within the joint limits."""
    arm = model.arrays.robot.arm
    return lambda count, seed: np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.dof))
