"""Distances, contact normals and witness points: against coal, finite differences and closed forms."""

import coal
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner import ConvexBody, certified_distance, separation, signed_distance
from regrasp_planner.geometry import contact_direction, qhull, support_point

PAIRS = 1000


def random_pose(rng, spread):
    rotation = jaxlie.SO3(jnp.asarray((q := rng.normal(size=4)) / np.linalg.norm(q)))
    return np.concatenate([np.asarray(rotation.wxyz), rng.normal(size=3) * spread])


def random_vertices(rng, count, size=0.05):
    vertices = rng.normal(size=(count, 3))
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices *= rng.uniform(0.5, 1, size=(count, 1)) * rng.uniform(0.4, 1, 3) * size / 2
    return vertices


def coal_distance(vertices_a, pose_a, vertices_b, pose_b):
    shapes, placed = [], []
    for vertices, pose in ((vertices_a, pose_a), (vertices_b, pose_b)):
        hull = qhull(vertices)
        points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        points.extend(list(vertices))
        triangles.extend([coal.Triangle(*map(int, triangle)) for triangle in hull.simplices])
        shapes.append(coal.Convex(points, triangles))
        placed.append(coal.Transform3s(np.asarray(jaxlie.SO3(pose[:4]).as_matrix()), pose[4:]))
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    return coal.distance(shapes[0], placed[0], shapes[1], placed[1], request, coal.DistanceResult())


@pytest.fixture(scope="module")
def pairs():
    rng = np.random.default_rng(7)
    a = [random_vertices(rng, rng.integers(8, 17)) for _ in range(PAIRS)]
    b = [random_vertices(rng, rng.integers(8, 33)) for _ in range(PAIRS)]
    poses_a = np.stack([random_pose(rng, 0.0) for _ in range(PAIRS)])
    poses_b = np.stack([random_pose(rng, 0.025) for _ in range(PAIRS)])
    exact = np.array([coal_distance(*pair) for pair in zip(a, poses_a, b, poses_b, strict=True)])
    bodies_a = ConvexBody.stack([ConvexBody.from_vertices(v) for v in a]).padded_to(vertices=16)
    bodies_b = ConvexBody.stack([ConvexBody.from_vertices(v) for v in b]).padded_to(vertices=32)
    return bodies_a, jnp.asarray(poses_a), bodies_b, jnp.asarray(poses_b), exact


def test_never_larger_than_coal_and_close_to_it(pairs):
    *arguments, exact = pairs
    found = np.asarray(separation(*arguments).distance)
    assert (exact > 0).sum() > 500
    assert (exact < 0).sum() > 50
    assert (exact - found).min() > -1e-9
    assert (exact - found).max() < 5e-4
    # Without the extra starts overlapping pairs may end at another maximum, but separated ones do not.
    quick = np.asarray(separation(*arguments, thorough=False).distance)
    assert (exact - quick).min() > -1e-9
    assert (exact - quick)[exact > 0].max() < 5e-4


def test_certified_distance_is_a_tight_bound_even_from_a_blunt_dsf(pairs):
    bodies_a, poses_a, bodies_b, poses_b, exact = pairs
    sharp = np.asarray(certified_distance(bodies_a, poses_a, bodies_b, poses_b))
    blunt = certified_distance(bodies_a.with_sharpness(32), poses_a, bodies_b.with_sharpness(32), poses_b)
    assert (exact - sharp).min() > -1e-9
    assert (exact - sharp)[exact > 0].max() < 1e-4
    assert (exact - np.asarray(blunt)).min() > -1e-9
    assert np.median((exact - np.asarray(blunt))[exact > 0]) < 5e-4


def test_swapping_the_bodies_turns_the_normal_around(pairs):
    bodies_a, poses_a, bodies_b, poses_b, _ = pairs
    there, back = separation(bodies_a, poses_a, bodies_b, poses_b), separation(bodies_b, poses_b, bodies_a, poses_a)
    same = np.abs(np.asarray(there.distance - back.distance)) < 1e-9
    assert same.mean() > 0.98
    np.testing.assert_allclose(np.asarray(there.direction)[same], -np.asarray(back.direction)[same], atol=1e-4)


def test_witness_points_span_the_distance(pairs):
    *arguments, _ = pairs
    found = separation(*arguments)
    apart = np.asarray(found.distance) > 1e-3
    gap = np.asarray(found.point_b - found.point_a)
    along = np.asarray(found.distance)[:, None] * np.asarray(found.direction)
    np.testing.assert_allclose(gap[apart], along[apart], atol=1e-7)


def test_a_warm_start_finds_the_same(pairs):
    bodies_a, poses_a, bodies_b, poses_b, exact = pairs
    cold = separation(bodies_a, poses_a, bodies_b, poses_b)
    warm = separation(bodies_a, poses_a, bodies_b, poses_b, x0=cold.direction + 0.05)
    apart = exact > 0
    np.testing.assert_allclose(np.asarray(warm.distance)[apart], np.asarray(cold.distance)[apart], atol=1e-10)


def moved(pose, twist):
    return jaxlie.SE3(pose) @ jaxlie.SE3.exp(twist)


def fourth_order(function, size, step):
    columns = []
    for e in np.eye(size):
        columns.append(
            (8 * (function(step * e) - function(-step * e)) - (function(2 * step * e) - function(-2 * step * e)))
            / (12 * step)
        )
    return np.stack([np.asarray(c) for c in columns], axis=-1)


@jax.jit
def outcome(twists, a, pose_a, b, pose_b):
    """Distance, direction and both points, (10,), with A and B moved by the two halves of ``twists``."""
    poses = [moved(pose_a, twists[:6]).wxyz_xyz[None], moved(pose_b, twists[6:]).wxyz_xyz[None]]
    found = separation(ConvexBody.stack([a]), poses[0], ConvexBody.stack([b]), poses[1])
    return jnp.concatenate([found.distance, found.direction[0], found.point_a[0], found.point_b[0]])


forward, backward = jax.jit(jax.jacfwd(outcome)), jax.jit(jax.jacrev(outcome))


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**31), st.sampled_from([16, 32, 64, 512]), st.sampled_from([0.0, 0.01]), st.booleans())
def test_derivatives_match_finite_differences(seed, sharpness, radius, overlapping):
    rng = np.random.default_rng(seed)
    a = ConvexBody.from_vertices(random_vertices(rng, 12), radius, sharpness).padded_to(vertices=16)
    b = ConvexBody.from_vertices(random_vertices(rng, 14), 0.0, sharpness).padded_to(vertices=16)
    pose_a, pose_b = random_pose(rng, 0.0), random_pose(rng, 0.0)
    away = rng.normal(size=3)
    pose_b[4:] = away / np.linalg.norm(away) * (0.02 if overlapping else 0.08)
    arguments = (a, pose_a, b, pose_b)

    exact = np.asarray(forward(jnp.zeros(12), *arguments))
    # The normal may turn by many radians per metre, and the model holds while it turns by less than about 1/p.
    step = 1e-3 / sharpness / max(1.0, np.abs(exact[1:4]).max())
    expected = fourth_order(lambda t: outcome(jnp.asarray(t), *arguments), 12, step)
    for rows in (slice(0, 1), slice(1, 4), slice(4, 10)):
        # Rounding of the argmin, 1e-12 or so, is divided by the step.
        tolerance = 1e-5 * np.abs(expected[rows]).max() + 1e-11 / step
        np.testing.assert_allclose(exact[rows], expected[rows], rtol=0, atol=tolerance)
    np.testing.assert_allclose(backward(jnp.zeros(12), *arguments), exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_single_pairs_give_the_same_as_the_batch(pairs):
    bodies_a, poses_a, bodies_b, poses_b, _ = pairs
    found = separation(bodies_a, poses_a, bodies_b, poses_b)
    arguments = (bodies_a[3], jaxlie.SE3(poses_a[3]), bodies_b[3], jaxlie.SE3(poses_b[3]))
    assert float(signed_distance(*arguments)) == pytest.approx(float(found.distance[3]), abs=1e-12)
    np.testing.assert_allclose(contact_direction(*arguments), found.direction[3], atol=1e-9)
    slope = jax.grad(lambda z: signed_distance(*arguments[:3], jaxlie.SE3(poses_b[3].at[6].add(z))))(0.0)
    assert float(slope) == pytest.approx(float(found.direction[3, 2]), abs=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**31))
def test_spheres_and_capsules_have_their_closed_form_distance(seed):
    rng = np.random.default_rng(seed)
    start, end, center = rng.normal(size=(3, 3)) * 0.2
    middle, along = (start + end) / 2, (end - start) / np.linalg.norm(end - start)
    turn = np.linalg.svd(along[None])[2][[1, 2, 0]].T
    turn[:, 2] = along
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    pose = jaxlie.SE3.from_rotation_and_translation(jaxlie.SO3.from_matrix(jnp.asarray(turn)), jnp.asarray(middle))
    capsule = ConvexBody.capsule(0.03, float(np.linalg.norm(end - start)))
    sphere = ConvexBody.sphere(0.02)
    foot = start + np.clip((center - start) @ along, 0, np.linalg.norm(end - start)) * along
    expected = np.linalg.norm(center - foot) - 0.05
    found = float(signed_distance(capsule, pose, sphere, jaxlie.SE3.from_translation(jnp.asarray(center))))
    assert -2.5e-3 < found - expected < 1e-9 or expected < -0.03


def test_box_over_a_large_slab_touches_flat():
    slab, box = ConvexBody.box([1.2, 0.8, 0.02]), ConvexBody.box([0.05, 0.06, 0.07])
    over = jaxlie.SE3.from_translation(jnp.asarray([0.4, -0.3, 0.15]))
    found = float(signed_distance(slab, jaxlie.SE3.identity(), box, over))
    assert found == pytest.approx(0.15 - 0.01 - 0.035, abs=5e-4)
    normal = contact_direction(slab, jaxlie.SE3.identity(), box, over)
    np.testing.assert_allclose(normal, [0, 0, 1], atol=1e-3)


def test_contact_normal_is_where_both_bodies_support_each_other():
    rng = np.random.default_rng(3)
    a, b = (ConvexBody.from_vertices(random_vertices(rng, 12)) for _ in range(2))
    pose_b = jaxlie.SE3.from_translation(jnp.asarray([0.1, 0.02, 0.0]))
    x = contact_direction(a, jaxlie.SE3.identity(), b, pose_b)
    gap = pose_b.translation() + support_point(b, -x) - support_point(a, x)
    np.testing.assert_allclose(gap / jnp.linalg.norm(gap), x, atol=1e-7)


def test_batched_under_vmap_equals_the_flat_batch(pairs):
    bodies_a, poses_a, bodies_b, poses_b, _ = pairs
    some = slice(0, 12)
    flat = separation(bodies_a[some], poses_a[some], bodies_b[some], poses_b[some]).distance
    fold = lambda leaf: leaf[some].reshape(3, 4, *leaf.shape[1:])  # noqa: E731
    folded = jax.vmap(separation)(
        jax.tree.map(fold, bodies_a), fold(poses_a), jax.tree.map(fold, bodies_b), fold(poses_b)
    ).distance
    np.testing.assert_allclose(folded.reshape(-1), flat, atol=1e-10)
