"""Collision model: pairs, culling bounds, derivatives, and clearances against coal."""

import coal
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from regrasp_planner.collision.clearance import configuration_clearance, gripper_clearance
from regrasp_planner.collision.model import (
    batch_clearances,
    body_frames,
    collision_model,
    nearest_pairs,
    pair_bounds,
    pair_clearances,
)
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.robot.kinematics import forward_kinematics

ON_TABLE = {("link1", "table"): None}
HELD = ConvexBody.box((0.05, 0.06, 0.15))
clearances = jax.jit(batch_clearances)
frames = jax.jit(jax.vmap(body_frames, in_axes=(None, 0, 0)))


@pytest.fixture(scope="module")
def model(panda, build):
    held_pose = build.pose((0, 0, 0.04))
    return collision_model(panda, build.shelf_scene(2), held=[HELD], held_pose=held_pose, overrides=ON_TABLE)


def random_configurations(model, count, seed=0):
    arm = model.arrays.robot.arm
    return np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, arm.dof))


def coal_shape(body):
    vertices = body.hull_vertices()
    points = coal.StdVec_Vec3s()
    for vertex in vertices:
        points.append(vertex)
    hull = coal.Convex.convexHull(points, True, "Qt")
    hull.setSweptSphereRadius(float(body.radius))
    return hull


def coal_clearances(model, q, theta):
    """Smallest distance minus margin over all pairs, by an independent code on the exact hulls."""
    arrays = model.arrays
    poses = np.asarray(frames(arrays, jnp.asarray(q), jnp.full(len(q), theta)))
    shapes = [coal_shape(arrays.bodies[i]) for i in range(len(model.body_names))]
    pairs = np.asarray(arrays.pairs)[np.asarray(arrays.valid)]
    margin = np.asarray(arrays.margin)[np.asarray(arrays.valid)]
    result = np.full(len(q), np.inf)
    for n in range(len(q)):
        matrices = np.asarray(jaxlie.SE3(jnp.asarray(poses[n])).as_matrix())
        placed = [coal.Transform3s(m[:3, :3], m[:3, 3]) for m in matrices]
        for (a, b), needed in zip(pairs, margin, strict=True):
            request, answer = coal.DistanceRequest(), coal.DistanceResult()
            gap = coal.distance(shapes[a], placed[a], shapes[b], placed[b], request, answer)
            result[n] = min(result[n], gap - needed)
    return result


def test_clearance_agrees_with_coal(model):
    q = random_configurations(model, 40)
    found = configuration_clearance(model, q, 0.03, cap=0.05)
    oracle = np.minimum(coal_clearances(model, q, 0.03), 0.05)
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


def test_bounds_are_lower_bounds_and_culling_loses_nothing(model):
    q = random_configurations(model, 4, seed=1)
    theta = np.full(4, 0.02)
    count = len(model.pairs)
    every = np.tile(np.arange(count), (4, 1))
    value, _ = clearances(model.arrays, jnp.asarray(q), jnp.asarray(theta), jnp.asarray(every))
    value = np.where(model.arrays.valid, value, np.inf)
    poses = frames(model.arrays, jnp.asarray(q), jnp.asarray(theta))
    bounds = jax.jit(pair_bounds)(model.arrays, poses)
    # A DSF may lie below the hull by its sharpness, so below the hull's bound too.
    assert np.all(np.asarray(bounds)[:, model.arrays.valid] <= value[:, model.arrays.valid] + 6e-3)
    assert np.isinf(bounds[:, ~np.asarray(model.arrays.valid)]).all()
    found = configuration_clearance(model, q, theta, cap=10.0)
    np.testing.assert_allclose(found.value, value.min(1), atol=1e-6)
    np.testing.assert_array_equal(found.pair, value.argmin(1))


def test_derivatives_match_finite_differences(model):
    q = random_configurations(model, 4, seed=3)
    theta = jnp.full(4, 0.02)
    pairs = jnp.tile(jnp.arange(len(model.pairs)), (4, 1))
    value, slope = clearances(model.arrays, jnp.asarray(q), theta, pairs)
    direction, h = np.random.default_rng(0).normal(size=7), 1e-6
    ahead, _ = clearances(model.arrays, jnp.asarray(q + h * direction), theta, pairs)
    behind, _ = clearances(model.arrays, jnp.asarray(q - h * direction), theta, pairs)
    apart = np.asarray(value) > 0
    assert apart.sum() > 20
    difference = np.asarray(ahead - behind) / (2 * h)
    np.testing.assert_allclose((slope @ direction)[apart], difference[apart], atol=1e-4)

    nearest = jax.jit(lambda x: nearest_pairs(model.arrays, x, jnp.asarray(0.02), 12))(jnp.asarray(q[0]))
    jacobian = jax.jit(jax.jacfwd(lambda x: pair_clearances(model.arrays, x, jnp.asarray(0.02), nearest)))
    np.testing.assert_allclose(jacobian(jnp.asarray(q[0])), slope[0][nearest], atol=1e-6)


def test_gripper_clearance_is_that_of_the_pairs_the_arm_cannot_change(model):
    q = random_configurations(model, 30, seed=4)
    targets = jax.jit(jax.vmap(lambda x: forward_kinematics(model.arrays.robot.arm, x)[-1]))(jnp.asarray(q))
    hand = gripper_clearance(model, np.asarray(targets), 0.02, cap=0.05)
    whole = configuration_clearance(model, q, 0.02, cap=0.05)
    assert np.all(whole.value <= hand.value + 1e-9)
    same = whole.pair == hand.pair
    assert same.sum() >= 3
    np.testing.assert_allclose(whole.value[same], hand.value[same], atol=1e-9)


def test_pairs_margins_and_overrides(panda, build):
    obstacles = (
        build.box_obstacle("table", (1, 1, 0.04), (0.4, 0, -0.03)),
        build.box_obstacle("cup", (0.05, 0.05, 0.1), (0.5, 0, 0.05)),
    )
    bare = collision_model(panda, obstacles)
    loose = collision_model(
        panda,
        obstacles,
        held=[HELD],
        overrides={("gripper", "cup"): None, ("held", "table"): -0.003, ("arm", "world"): 0.02},
    )

    def margins(model):
        valid = np.flatnonzero(model.arrays.valid)
        return {(model.describe(p), model.kind(p)): float(model.arrays.margin[p]) for p in valid}

    assert margins(bare)["palm – cup", "world collision"] == pytest.approx(0.005)
    assert ("palm – cup", "world collision") not in margins(loose)
    assert margins(loose)["held – table", "held object"] == pytest.approx(-0.003)
    assert margins(loose)["held – cup", "held object"] == pytest.approx(0.005)
    assert margins(loose)["link5 – cup", "world collision"] == pytest.approx(0.02)
    assert not any("link0 – table" in name for name, _ in margins(bare))  # the base never moves
    with pytest.raises(ValueError, match="names 'mug'"):
        collision_model(panda, obstacles, overrides={("gripper", "mug"): None})


def test_another_scene_does_not_compile_again(panda, build):
    count = []
    for seed in range(3):
        model = collision_model(panda, build.shelf_scene(seed, clutter=seed + 3), overrides=ON_TABLE)
        shapes = jax.tree.map(jnp.shape, model.arrays)
        count.append(str(shapes))
    assert len(set(count)) == 1


def test_empty_input(model):
    assert configuration_clearance(model, np.zeros((0, 7)), 0.0).value.shape == (0,)
