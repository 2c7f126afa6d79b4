"""Poses and rotations.

The last bits of scenes depend on the rounding here: do not reorder arithmetic.
"""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

Pose = Float[np.ndarray, " 7"]
"""wxyz_xyz: unit quaternion and position in metres."""

_POSITIVE = np.array([1.0, 0.41, 0.33, 0.27])


def turn(angles: float | Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch 2 2"]:
    """Rotations of the plane by angles in radians."""
    c, s = np.cos(angles), np.sin(angles)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def about_z(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about z by an angle in radians."""
    rotation = np.eye(3)
    rotation[:2, :2] = turn(angle)
    return rotation


def turning_down(direction: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that turns a unit direction to −z."""
    x, y, z = direction
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula about direction × (−z) = (−y, x, 0).
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1 - z)


def plane_frame(normal: Float[np.ndarray, " 3"], outward: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Right-handed frame with the unit normal as z axis and its x axis as close as possible to ``outward``."""
    x = outward - (outward @ normal) * normal
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(normal, x), normal])


def to_pose(quaternion: Float[np.ndarray, " 4"], position: Float[np.ndarray, " 3"] | list[float]) -> Pose:
    """wxyz_xyz of a unit quaternion, with the sign that makes w ≥ 0, and a position."""
    return np.concatenate([quaternion if quaternion[0] >= 0 else -quaternion, np.asarray(position, float)])


def shepperd_quaternion(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 4"]:
    """(4,) wxyz of a rotation matrix by Shepperd's method, which computes the largest component first.

    SciPy's and MuJoCo's conversions differ in the last bit. Scenes of `PandaYCB-v0` come from this one, those of
    `PandaYCBLift-v0` from SciPy's and those of `ExcavatorStones-v0` from MuJoCo's: none can replace another.
    """
    r = rotation
    squares = np.array([np.trace(r), r[0, 0], r[1, 1], r[2, 2]])
    largest = int(squares.argmax())
    if largest == 0:
        quaternion = np.array([1 + squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    else:
        i, j, k = largest - 1, largest % 3, (largest + 1) % 3
        quaternion = np.empty(4)
        quaternion[0] = r[k, j] - r[j, k]
        quaternion[1 + i] = 1 + r[i, i] - r[j, j] - r[k, k]
        quaternion[1 + j] = r[j, i] + r[i, j]
        quaternion[1 + k] = r[k, i] + r[i, k]
    return quaternion / np.linalg.norm(quaternion)


def mujoco_quaternion(rotation: Float[np.ndarray, "3 3"] | Float[np.ndarray, " 9"]) -> Float[np.ndarray, " 4"]:
    """(4,) wxyz of a rotation matrix, or of its 9 entries row by row, by MuJoCo's conversion."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion


def canonical(pose: Float[np.ndarray, "*batch 7"]) -> Float[np.ndarray, "*batch 7"]:
    """The same poses with the one of their two unit quaternions that has w + 0.41 x + 0.33 y + 0.27 z ≥ 0.

    Not w ≥ 0: objects often lie upside down, with w zero up to noise, and the sign would flip with the noise.
    """
    quaternion = pose[..., :4] / np.linalg.norm(pose[..., :4], axis=-1, keepdims=True)
    flip = (quaternion @ _POSITIVE)[..., None] < 0
    return np.concatenate([np.where(flip, -quaternion, quaternion), pose[..., 4:]], axis=-1)
