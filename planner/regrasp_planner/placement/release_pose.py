"""Poses of the target in the release area: at rest, and at the release before it settles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from regrasp_planner.pose import Pose
from regrasp_planner.task import ReleaseArea


def resting_poses(
    area: ReleaseArea,
    hull: Float[np.ndarray, "N 3"],
    rotation: Float[np.ndarray, "3 3"],
    yaws: int,
    release_positions: Sequence[tuple[float, float]] = ((0.0, 0.0),),
) -> list[Pose]:
    """Poses in the release area in which the target rests in one stable pose, at several turns about the vertical.

    Args:
        area: the release area.
        hull: (N, 3) vertices of the target, metres.
        rotation: target to world, of the stable pose.
        yaws: number of turns, evenly spread.
        release_positions: (x, y) positions of the target from −1 to 1, as shares of the room it has to move within the
            area; 0 is the middle.

    Returns:
        Poses (7,), position by position, without those in which the target does not fit into the area.
    """
    poses: list[Pose] = []
    for share in release_positions:
        for yaw in np.arange(yaws) * (2 * np.pi / yaws):
            turned = Rotation.from_euler("z", yaw) * Rotation.from_matrix(rotation)
            points = turned.apply(hull)
            low, high = points.min(axis=0), points.max(axis=0)
            room = area.half_extents - 0.5 * (high - low)[:2]
            if (room < 0).any():
                continue
            middle = area.center[:2] + room * share
            position = np.append(middle - 0.5 * (low + high)[:2], area.center[2] - low[2])
            poses.append(np.concatenate([turned.as_quat(scalar_first=True), position]))
    return poses


def tilted_pose(settled: Pose, down: Float[np.ndarray, " 3"], hull: Float[np.ndarray, "N 3"], drop: float) -> Pose:
    """Pose g_T^pre of the release after which the target settles into ``settled`` (g_T^post).

    The target is turned the shortest way until ``down`` points down, about its lowest vertex when tilted: it is assumed
    to roll over the vertices it stands on.

    Args:
        settled: (7,) pose at rest.
        down: (3,) unit direction in the target's frame that points down at the release; for a static release that of
            the pose at rest.
        hull: (N, 3) vertices of the target, metres.
        drop: height of the target above the ground at the release, metres.
    """
    resting = Rotation.from_quat(settled[:4], scalar_first=True)
    was, wanted = resting.apply(down), np.array([0.0, 0.0, -1.0])
    axis = np.cross(was, wanted)
    size = float(np.linalg.norm(axis))
    angle = np.arctan2(size, was @ wanted)
    turn = Rotation.from_rotvec(axis / size * angle) if size > 1e-12 else Rotation.identity()
    tilted = turn * resting
    pivot = hull[(hull @ down).argmax()]
    position = resting.apply(pivot) + settled[4:] - tilted.apply(pivot)
    # The ground is as far below the settled target's lowest point as below the tilted one's.
    ground = float(resting.apply(hull)[:, 2].min() + settled[6])
    position[2] = ground + drop - float(tilted.apply(hull)[:, 2].min())
    return np.concatenate([tilted.as_quat(scalar_first=True), position])
