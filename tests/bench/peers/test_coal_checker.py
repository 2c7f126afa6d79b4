"""The exact judge of collisions."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from regrasp_bench.peers.coal_checker import BODY_STEP, JOINT_STEP, ExactChecker
from regrasp_bench.peers.ompl_rrt import polyline
from regrasp_planner.collision.clearance import configuration_clearance
from regrasp_planner.collision.model import CollisionModel, body_frames
from regrasp_planner.grasp.grasp import Grasp
from regrasp_planner.stages.collision_models import CollisionModels

THETA = 0.03


@pytest.fixture(scope="module", params=["empty", "holding"])
def model(request: pytest.FixtureRequest, empty_handed: CollisionModel, models: CollisionModels) -> CollisionModel:
    if request.param == "empty":
        return empty_handed
    pose = np.append(Rotation.from_euler("xyz", [0.3, 0.2, 1.0]).as_quat(scalar_first=True), [0.01, 0.0, 0.02])
    return models.holding(Grasp(pose, THETA, 0.04, 1.0, 0.0))


@pytest.fixture(scope="module")
def configurations(world: Any) -> np.ndarray:
    arm = world.planner_robot.arm
    return np.random.default_rng(0).uniform(np.asarray(arm.lower), np.asarray(arm.upper), (150, arm.dof))


def brute_force(model: Any, q: np.ndarray) -> np.ndarray:
    """Signed distances by coal of every pair, placed by the planner's kinematics, the sweeps taken off by hand."""
    import coal
    from scipy.spatial import ConvexHull

    shapes = []
    for i in range(model.arrays.bodies.batch_size):
        points = model.arrays.bodies[i].hull_vertices()
        vertices, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        vertices.extend(list(points))
        triangles.extend([coal.Triangle(*map(int, corners)) for corners in ConvexHull(points).simplices])
        shapes.append(coal.Convex(vertices, triangles))
    radius = np.asarray(model.arrays.bodies.radius)
    poses = np.asarray(jax.vmap(lambda one: body_frames(model.arrays, one, THETA))(q))
    request = coal.DistanceRequest()
    out = []
    for here in poses:
        places = [coal.Transform3s(Rotation.from_quat(p[:4], scalar_first=True).as_matrix(), p[4:]) for p in here]
        for a, b in model.pairs[np.asarray(model.arrays.valid)]:
            result = coal.DistanceResult()
            coal.distance(shapes[a], places[a], shapes[b], places[b], request, result)
            out.append(result.min_distance - radius[a] - radius[b])
    return np.array(out).reshape(len(q), -1)


def test_clearances_are_those_of_every_pair(model: Any, configurations: np.ndarray) -> None:
    checker = ExactChecker(model, THETA)
    few = configurations[:25]
    found, expected = checker.clearances(few, cap=0.1), brute_force(model, few) - checker.floor
    near = expected < 0.1 - 1e-6
    assert near.any()
    assert found[near] == pytest.approx(expected[near], abs=1e-5)
    assert (found[~near] >= 0.1 - 1e-6).all()


def test_free_means_that_no_pair_overlaps(model: Any, configurations: np.ndarray) -> None:
    checker = ExactChecker(model, THETA)
    free = np.array([checker.free(q[None]) for q in configurations])
    assert 0.1 < free.mean() < 0.95
    assert (free == (checker.clearances(configurations).min(axis=1) >= 0)).all()
    assert not checker.free(configurations)
    assert checker.free(configurations[free])
    # The planner's own certificates never claim more.
    margins = np.asarray(model.arrays.margin)[np.asarray(model.arrays.valid)]
    assert (margins >= 0).all()
    claimed = configuration_clearance(model, configurations, THETA, cap=0.0, exact=True).value >= 0
    assert (free | ~claimed).all()


def test_samples_are_near_enough_to_each_other(model: Any, world: Any) -> None:
    checker = ExactChecker(model, THETA)
    arm = world.planner_robot.arm
    corners = np.random.default_rng(1).uniform(np.asarray(arm.lower), np.asarray(arm.upper), (3, arm.dof))
    course = polyline(corners)
    at = checker.samples(course)
    q = course(at)
    assert at[0] == 0.0
    assert at[-1] == 1.0
    assert np.abs(np.diff(q, axis=0)).max() <= JOINT_STEP
    bodies = model.arrays.bodies
    poses = np.asarray(jax.vmap(lambda one: body_frames(model.arrays, one, THETA))(q))
    turns = Rotation.from_quat(poses[..., :4].reshape(-1, 4), scalar_first=True).as_matrix()
    turns = turns.reshape(*poses.shape[:2], 3, 3)
    points = np.einsum("nmij,mvj->nmvi", turns, np.asarray(bodies.vertices)) + poses[:, :, None, 4:]
    assert np.linalg.norm(np.diff(points, axis=0), axis=-1).max() <= BODY_STEP


def test_a_path_through_something_is_caught(world: Any, empty_handed: CollisionModel) -> None:
    checker = ExactChecker(empty_handed, THETA)
    home = np.asarray(world.planner_robot.home)
    down = home.copy()
    down[1] += 2.0
    assert not checker.collisions(polyline(np.stack([home, home + 0.02])))
    found = checker.collisions(polyline(np.stack([home, down, home])))
    assert found
    assert "table" in {name for pair in found for name in pair[:2]}
    assert found[0][2] == max(depth for _, _, depth in found) > 0.01
    assert not checker.collisions(polyline(np.stack([home, down, home])), allowed=found[0][2] + 1e-6)
    # The ends are free: it is what lies between that counts.
    assert checker.free(home[None])
