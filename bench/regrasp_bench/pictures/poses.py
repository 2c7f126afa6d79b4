"""Stable poses of several objects on the ground, with their release cones (the paper's Fig. 10)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from regrasp_bench.pictures.studio import (
    COLOURS,
    Picture,
    Studio,
    arrow,
    cone,
    cropped,
    pose_along,
    to_pixels,
    write_text,
)
from regrasp_gym.objects import OBJECTS, ObjectModel
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.rendering.surfaces import faceted
from regrasp_planner import stable_poses
from regrasp_planner.placement.basins import release_cones

SHOWN = (
    "025_mug",
    "006_mustard_bottle",
    "004_sugar_box",
    "010_potted_meat_can",
    "012_strawberry",
    "016_pear",
    "021_bleach_cleanser",
)
"""Objects of various shapes and sizes, one of them hollow."""

ALIKE = 2e-3
"""Poses count as alike if the centre of mass is equally high and equally far from the rim, to this many metres."""

_ACROSS, _DEEP = 0.27, 0.33


def poses_picture(names: Sequence[str] = SHOWN, rows: int = 3, height: int = 760, width: int = 1400) -> Picture:
    """One column for each object, in its most likely stable poses, the likeliest in front.

    The arrow is the normal of the ground, from the centre of mass. Released with another direction of the cone upwards,
    the object settles into the pose shown. Percentages are landing probabilities, summed over sides that are alike.
    Hollow objects stand on their convex hull, drawn in blue.

    Args:
        names: names of shipped objects.
        rows: largest number of poses of each.
        height, width: pixels.
    """
    depth, breadth = _DEEP * (rows - 1), _ACROSS * (len(names) - 1)
    studio = Studio(size=max(breadth, depth, 0.3))
    camera = Camera("c", (0.0, -2.3, 1.9), (0.0, 0.0, 0.0), 22.0)
    labels: list[tuple[np.ndarray, str]] = []
    for column, name in enumerate(names):
        model = OBJECTS[name]
        x = _ACROSS * column - 0.5 * breadth
        for row, (rotation, half_angle, share) in enumerate(_likeliest(model, rows)):
            front = _place(studio, model, rotation, half_angle, np.array([x, _DEEP * row - 0.5 * depth]), row)
            words = f"{100 * share:.0f} %" if row else f"{model.label}\n{100 * share:.0f} %"
            labels.append((np.array([x, front - 0.02, 0.0]), words))
    image = Image.fromarray(studio.picture(camera, height, width))
    pixels = to_pixels(camera, np.array([at for at, _ in labels]), height, width)
    for at, (_, words) in zip(pixels, labels, strict=True):
        write_text(image, (at[0], at[1]), words, 16, "ma")
    return cropped(np.asarray(image))


def _likeliest(model: ObjectModel, count: int) -> list[tuple[np.ndarray, float, float]]:
    """Rotation, half-angle of the cone and landing probability of poses that look different, the likeliest first."""
    body = model.body()
    poses = stable_poses(body.hull_vertices(), body.center_of_mass, starts=2000)
    cones = release_cones(poses)
    feature = np.column_stack([poses.height, poses.margin])
    taken: list[int] = []
    share: dict[int, float] = {}
    for k in np.argsort(-poses.probability, kind="stable").tolist():
        alike = next((other for other in taken if np.abs(feature[k] - feature[other]).max() < ALIKE), k)
        if alike == k:
            taken.append(k)
        share[alike] = share.get(alike, 0.0) + float(poses.probability[k])
    taken.sort(key=lambda k: -share[k])
    return [(poses.rotations[k], cones[k].half_angle, share[k]) for k in taken[:count]]


def _place(
    studio: Studio, model: ObjectModel, rotation: np.ndarray, half_angle: float, at: np.ndarray, colour: int
) -> float:
    """Add an object; returns its least y, towards the camera, metres."""
    points = np.concatenate(model.pieces) @ rotation.T
    # Each object shows its broad side: the longest side is across the line of sight.
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    axis = np.linalg.svd(flat, full_matrices=False)[2][0]
    turn = Rotation.from_euler("z", np.deg2rad(18) - np.arctan2(axis[1], axis[0])) * Rotation.from_matrix(rotation)
    points = turn.apply(np.concatenate(model.pieces))
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    center = np.array([at[0] - middle[0], at[1] - middle[1], -points[:, 2].min()])
    pose = np.concatenate([turn.as_quat(scalar_first=True), center])
    studio.add_object(model, pose)
    corners = np.concatenate(model.pieces)
    hull = ConvexHull(corners)
    if sum(ConvexHull(piece).volume for piece in model.pieces) < 0.6 * hull.volume:
        middle = corners.mean(axis=0)
        studio.add(faceted(middle + 1.03 * (corners - middle)), pose, (0.45, 0.7, 1.0, 0.16))
    up = np.array([0.0, 0.0, 1.0])
    red, green, blue, _ = COLOURS[colour]
    length = float(points[:, 2].max()) + 0.06
    studio.add(arrow(length, 0.0032), pose_along(up, center), (red, green, blue, 1.0))
    if half_angle > 0:
        studio.add(cone(half_angle, length - 0.02), pose_along(up, center), (red, green, blue, 0.35))
    return float(points[:, 1].min() + center[1])
