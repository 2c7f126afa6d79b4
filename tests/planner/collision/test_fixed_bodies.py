"""Clearance from fixed bodies against coal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform, Rotation

from regrasp_planner.collision.fixed_bodies import FixedBodies
from regrasp_planner.geometry.support import ConvexBody
from regrasp_planner.pose import wxyz_xyz


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**31), cap=st.sampled_from([0.0, 1.0]))
def test_least_slack_is_that_of_the_nearest_pair(coal_oracle, seed, cap):
    rng = np.random.default_rng(seed)
    count, needed = 12, rng.uniform(-0.002, 0.01, (2, 3))
    moving = [ConvexBody.from_vertices(rng.normal(size=(10, 3)) * 0.01), ConvexBody.capsule(0.01, 0.03)]
    bodies = [ConvexBody.from_vertices(rng.normal(size=(n, 3)) * 0.02) for n in (8, 30, 60)]
    turns = Rotation.random(3, rng=rng).as_quat(scalar_first=True)
    poses = np.concatenate([turns, rng.normal(size=(3, 3)) * 0.05], axis=1)
    placed = [
        RigidTransform.from_components(rng.normal(size=(count, 3)) * 0.06, Rotation.random(count, rng=rng))
        for _ in moving
    ]
    found = FixedBodies(bodies, poses).least_slack(moving, placed, needed, cap)
    for i in range(count):
        slack = min(
            coal_oracle.distance(moving[m], wxyz_xyz(placed[m][i]), bodies[w], poses[w]) - needed[m, w]
            for m in range(2)
            for w in range(3)
        )
        assert found[i] <= min(slack, cap) + 1e-9 or (found[i] < 0 and slack < 0)
        assert found[i] > min(slack, cap) - 2e-4 or slack < 0


@pytest.mark.parametrize(("bodies", "count"), [(0, 3), (1, 0)])
def test_without_pairs_the_cap_is_the_answer(build, bodies, count):
    box = ConvexBody.box((0.1, 0.1, 0.1))
    fixed = FixedBodies([box] * bodies, np.tile(build.pose(), (bodies, 1)))
    placed = [RigidTransform.identity(count)]
    np.testing.assert_array_equal(fixed.least_slack([box], placed, np.zeros((1, bodies)), 0.2), np.full(count, 0.2))
