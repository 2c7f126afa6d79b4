"""Clearances of configurations and gripper poses, against coal and against every pair."""

import jax
import jax.numpy as jnp
import numpy as np

from regrasp_planner.collision.clearance import configuration_clearance, gripper_clearance
from regrasp_planner.collision.model import body_frames
from regrasp_planner.robot.kinematics import forward_kinematics

frames = jax.jit(jax.vmap(body_frames, in_axes=(None, 0, 0)))


def coal_clearances(oracle, model, q, theta):
    """Smallest distance minus margin over all pairs, by an independent code on the exact hulls."""
    arrays = model.arrays
    poses = np.asarray(frames(arrays, jnp.asarray(q), jnp.full(len(q), theta)))
    bodies = [arrays.bodies[i] for i in range(len(model.body_names))]
    valid = np.asarray(arrays.valid)
    pairs = list(zip(model.pairs[valid], np.asarray(arrays.margin)[valid], strict=True))
    return np.array(
        [
            min(oracle.distance(bodies[a], posed[a], bodies[b], posed[b]) - needed for (a, b), needed in pairs)
            for posed in poses
        ]
    )


def test_clearance_agrees_with_coal(coal_oracle, model, random_configurations):
    q = random_configurations(40, seed=0)
    found = configuration_clearance(model, q, 0.03, cap=0.05)
    oracle = np.minimum(coal_clearances(coal_oracle, model, q, 0.03), 0.05)
    free = oracle > 0
    assert free.sum() >= 3
    assert (~free).sum() >= 10
    # Never above the exact value; below by the sharpness of the support functions only.
    assert np.all(found.value <= oracle + 1e-6)
    np.testing.assert_allclose(found.value[free], oracle[free], atol=2.5e-3)
    np.testing.assert_allclose(found.value[~free], oracle[~free], atol=6e-3)
    free_or_not = configuration_clearance(model, q, 0.03, cap=0)
    np.testing.assert_array_equal(free_or_not.value < 0, found.value < 0)
    np.testing.assert_array_equal(free_or_not.pair >= 0, found.value < 0)
    exact = configuration_clearance(model, q, 0.03, cap=0.05, exact=True)
    assert np.all(exact.value <= oracle + 1e-6)
    assert np.all(exact.value >= found.value - 1e-9)


def test_gripper_clearance_is_that_of_the_pairs_the_arm_cannot_change(model, random_configurations):
    q = random_configurations(30, seed=4)
    targets = jax.jit(jax.vmap(lambda x: forward_kinematics(model.arrays.robot.arm, x)[-1]))(jnp.asarray(q))
    hand = gripper_clearance(model, np.asarray(targets), 0.02, cap=0.05)
    whole = configuration_clearance(model, q, 0.02, cap=0.05)
    assert np.all(whole.value <= hand.value + 1e-9)
    same = whole.pair == hand.pair
    assert same.sum() >= 3
    np.testing.assert_allclose(whole.value[same], hand.value[same], atol=1e-9)


def test_empty_input(model):
    assert configuration_clearance(model, np.zeros((0, 7)), 0.0).value.shape == (0,)
    assert gripper_clearance(model, np.zeros((0, 7)), 0.0).pair.shape == (0,)
