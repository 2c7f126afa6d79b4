"""StabPose on every shipped object, against trimesh's quasi-static analysis of the same hull."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from regrasp_gym.objects import OBJECTS
from regrasp_planner import stable_poses

WITHIN = np.cos(np.radians(5))


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_stable_poses_are_those_of_trimesh(name):
    body = OBJECTS[name].body()
    vertices = body.hull_vertices()
    found = stable_poses(vertices, body.center_of_mass)
    hull = trimesh.convex.convex_hull(vertices)
    transforms, probability = trimesh.poses.compute_stable_poses(
        hull, center_mass=body.center_of_mass, sigma=0, n_samples=1, threshold=0
    )
    # Down, in the object's frame.
    expected = -transforms[:, 2, :3]
    near = expected @ found.directions.T > WITHIN
    assert probability[near.any(axis=1)].sum() >= 0.99 * probability.sum()
    # None invented: on an exact facet, with the centre of mass over it.
    points = vertices - body.center_of_mass
    for direction in found.directions:
        heights = points @ direction
        on = points[heights > heights.max() - 1e-6]
        assert len(on) >= 3
        across = np.linalg.svd(direction[None])[2][1:]
        # The foot of the centre of mass is the origin: inside of all edges.
        assert (ConvexHull(on @ across.T).equations[:, 2] < 0).all()
