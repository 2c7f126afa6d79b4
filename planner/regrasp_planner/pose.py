"""Poses on the host: between the stored form and scipy's rigid transforms, without a trip through JAX."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import RigidTransform, Rotation

Pose = Float[np.ndarray, " 7"]
"""A pose as wxyz_xyz: unit quaternion, then position in metres. ``jaxlie.SE3(pose)`` makes it a group element."""

IDENTITY: Pose = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def rigid(pose: Float[np.ndarray, "*batch 7"]) -> RigidTransform:
    """The pose (7,), or a batch of them, as a transform that composes with ``*`` and has ``inv()`` and ``apply()``."""
    pose = np.asarray(pose, float)
    return RigidTransform.from_components(pose[..., 4:], Rotation.from_quat(pose[..., :4], scalar_first=True))


def wxyz_xyz(transform: RigidTransform) -> Float[np.ndarray, "*batch 7"]:
    """The stored form of a transform."""
    quaternion = transform.rotation.as_quat(scalar_first=True)
    return np.concatenate([quaternion, transform.translation], axis=-1)
