"""Resting poses: contact, stability and landing probabilities."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_gym.errors import SceneError
from regrasp_gym.objects.model import solid
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.resting import MIN_MARGIN, least_width, resting_poses, upright_pose
from regrasp_gym.scenes.table_shelf_config import TARGETS, TableShelfConfig, check_target


@pytest.mark.parametrize("name", OBJECTS)
def test_resting_poses_rest(name):
    model = OBJECTS[name]
    poses = resting_poses(model)
    assert sum(pose.probability for pose in poses) == pytest.approx(1)
    for pose in poses:
        points = np.concatenate(model.pieces) @ pose.rotation.T
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(pose.rotation @ pose.down, [0, 0, -1], atol=1e-9)
        assert points[:, 2].min() == pytest.approx(-pose.height, abs=1e-12)
        support = points[points[:, 2] < -pose.height + 1e-6][:, :2]
        equations = ConvexHull(support).equations
        assert -equations[:, 2].max() == pytest.approx(pose.margin, abs=1e-9)
        assert pose.margin > 0


@pytest.mark.parametrize("name", ["003_cracker_box", "006_mustard_bottle", "010_potted_meat_can", "065-a_cups"])
def test_landing_probabilities_agree_with_trimesh(name):
    model = OBJECTS[name]
    hull = trimesh.convex.convex_hull(np.concatenate(model.pieces))
    transforms, chances = trimesh.poses.compute_stable_poses(
        hull, center_mass=np.zeros(3), sigma=0, n_samples=1, threshold=0
    )
    ours = resting_poses(model)
    downs = np.array([transform[:3, :3].T @ [0, 0, -1] for transform in transforms])
    # Ours leave out poses with next to no margin; trimesh does not.
    theirs = np.array([chances[downs @ pose.down > np.cos(np.deg2rad(1))].sum() for pose in ours])
    assert theirs.sum() > 0.9
    np.testing.assert_allclose([pose.probability for pose in ours], theirs / theirs.sum(), atol=0.005)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(6, 30))
def test_resting_poses_of_random_hulls(seed, count):
    rng = np.random.default_rng(seed)
    model = solid(f"stone_{seed}_{count}", "stone", 1.0, [rng.normal(size=(count, 3)) * [0.05, 0.04, 0.03]])
    poses = resting_poses(model)
    assert sum(pose.probability for pose in poses) == pytest.approx(1)
    offsets = -ConvexHull(np.concatenate(model.pieces)).equations[:, 3]
    for pose in poses:
        assert np.abs(offsets - pose.height).min() < 1e-9
    # The facet nearest to the centre of mass is always one to rest on, and left out only if its margin is small.
    hull = ConvexHull(np.concatenate(model.pieces))
    facet = hull.points[hull.simplices[offsets.argmin()]]
    normal = hull.equations[offsets.argmin(), :3]
    edges = np.roll(facet, -1, axis=0) - facet
    margin = np.abs(np.einsum("ij,ij->i", np.cross(normal, edges), facet)) / np.linalg.norm(edges, axis=1)
    kept = min(pose.height for pose in poses) == pytest.approx(offsets.min())
    assert kept or margin.min() < MIN_MARGIN


def test_upright_is_upright():
    for name in TARGETS:
        pose = upright_pose(OBJECTS[name])
        assert pose is not None
        assert pose.rotation[2, 2] > np.cos(np.deg2rad(10))
    leaning = Rotation.from_euler("x", 30, degrees=True).apply(OBJECTS["003_cracker_box"].pieces[0])
    model = solid("leaning_box", "leaning box", 0.4, [leaning])
    assert upright_pose(model) is None
    with pytest.raises(SceneError, match=r"leaning_box.*does not stand upright"):
        check_target(model, TableShelfConfig())


def test_least_width_of_a_box_is_its_shortest_edge():
    assert least_width(OBJECTS["009_gelatin_box"]) == pytest.approx(0.03)
