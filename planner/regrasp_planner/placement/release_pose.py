"""Where in the release area the target is put down, how it is held when let go, and where it comes to rest."""

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
    spots: Sequence[tuple[float, float]] = ((0.0, 0.0),),
) -> list[Pose]:
    """Poses in the release area in which the target rests on one side, at several turns about the vertical.

    Args:
        area: where it may be put down.
        hull: (N, 3) vertices of the target, metres.
        rotation: target to world, of the stable pose.
        yaws: number of turns, evenly spread.
        spots: where the target stands: (x, y) from −1 to 1, as far as it can be moved within the area; 0 is its middle.

    Returns:
        Poses (7,), spot by spot, without those in which the target does not fit into the area.
    """
    poses: list[Pose] = []
    for spot in spots:
        for yaw in np.arange(yaws) * (2 * np.pi / yaws):
            turned = Rotation.from_euler("z", yaw) * Rotation.from_matrix(rotation)
            points = turned.apply(hull)
            low, high = points.min(axis=0), points.max(axis=0)
            room = area.half_extents - 0.5 * (high - low)[:2]
            if (room < 0).any():
                continue
            middle = area.center[:2] + room * spot
            position = np.append(middle - 0.5 * (low + high)[:2], area.center[2] - low[2])
            poses.append(np.concatenate([turned.as_quat(scalar_first=True), position]))
    return poses


def tilted_pose(settled: Pose, down: Float[np.ndarray, " 3"], hull: Float[np.ndarray, "N 3"], drop: float) -> Pose:
    """The pose g_T^pre in which the target is let go so that it comes to rest in ``settled`` (g_T^post).

    The target is turned the shortest way until ``down`` points down. It is taken to roll over the vertices it stands
    on: the lowest vertex of the tilted target stays where it is.

    Args:
        settled: (7,) pose at rest.
        down: (3,) unit direction in the target's frame; that of the pose at rest for a static release.
        hull: (N, 3) vertices of the target, metres.
        drop: height above the ground from which it is let go, metres.
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
