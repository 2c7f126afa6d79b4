"""Where the objects and fixtures of a scene are, computed apart from the scenes' own code."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_gym.geometry.poses import Pose
from regrasp_gym.objects.model import ObjectModel
from regrasp_gym.scenes.scene import Fixture


def rotation(pose: Pose) -> np.ndarray:
    return Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()


def world_points(model: ObjectModel, pose: Pose) -> np.ndarray:
    """Corners of an object's pieces at a pose."""
    return np.concatenate(model.pieces) @ rotation(pose).T + pose[4:]


def box_corners(fixture: Fixture) -> np.ndarray:
    half = np.array(list(itertools.product((-1, 1), repeat=3))) * fixture.size / 2
    return half @ rotation(fixture.pose).T + fixture.pose[4:]
