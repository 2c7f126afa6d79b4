"""Scenes of stones on slopes for the tests, and the frames of their slopes."""

from __future__ import annotations

import numpy as np
from scene_geometry import rotation

from regrasp_gym.scenes.scene import Fixture
from regrasp_gym.scenes.slopes import SlopesScene, make_scene

SCENES = [make_scene(seed) for seed in range(60)]


def fixture(scene: SlopesScene, name: str) -> Fixture:
    return next(f for f in scene.fixtures if f.name == name)


def top_face(scene: SlopesScene, name: str) -> tuple[np.ndarray, np.ndarray]:
    """A point of a slope's surface and its frame."""
    slope = fixture(scene, name)
    frame = rotation(slope.pose)
    return slope.pose[4:] + frame[:, 2] * slope.size[2] / 2, frame
