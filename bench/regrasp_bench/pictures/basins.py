"""Basins on the sphere of directions, and the cones inscribed in them (the paper's Fig. 6)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from regrasp_bench.pictures.studio import (
    COLOURS,
    Picture,
    Studio,
    arrow,
    captioned,
    pose_along,
    side_by_side,
)
from regrasp_gym.objects import OBJECTS
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.rendering.surfaces import Look, faceted, grid_surface, joined, revolve
from regrasp_planner import stable_poses
from regrasp_planner.geometry.hull import solid_center
from regrasp_planner.placement.basins import release_cones
from regrasp_planner.placement.stab_pose import fibonacci_sphere
from regrasp_planner.pose import IDENTITY

STONE = "stone"
"""Name of a random convex body, which is not a shipped object."""

STARTS = 3000
_DOT, _ARROW = 0.017, 1.42
_DISTANCE = 6.6


def basins_picture(name: str = STONE, size: int = 440) -> Picture:
    """Three spheres: the object with its stable directions, the starts by basin, and the cones inscribed in them.

    Args:
        name: name of a shipped object, or `STONE`.
        size: height and width of each of the three, pixels.
    """
    points, center = _stone() if name == STONE else _shipped(name)
    poses = stable_poses(points, center, starts=STARTS)
    cones = release_cones(poses)
    # The largest basins get the most distinguishable colours.
    order = np.argsort(-poses.probability, kind="stable")
    colour = {int(k): COLOURS[i % len(COLOURS)] for i, k in enumerate(order)}
    scale = 0.82 / np.linalg.norm(points - center, axis=1).max()

    camera = _camera(poses.directions, np.array([cone.half_angle for cone in cones]))
    panels: list[Picture] = []
    for caption in (
        "(a) stable directions",
        "(b) starts, by the pose that each settles into",
        "(c) cones inscribed in the basins",
    ):
        studio = Studio(ground=None, size=3.0)
        if not panels:
            if name == STONE:
                studio.add(faceted((points - center) * scale, (0.72, 0.7, 0.67, 1.0)))
            else:
                for look in OBJECTS[name].looks:
                    studio.add(look.shifted(-center).stretched(scale))
        else:
            studio.add(_ball(0.998), IDENTITY, (0.93, 0.93, 0.93, 1.0))
        for k, direction in enumerate(poses.directions):
            if poses.probability[k] == 0:
                continue
            rgba = colour[k]
            length = _ARROW if panels else max(1.15, scale * poses.height[k] + 0.45)
            studio.add(arrow(length, 0.022), pose_along(direction, np.zeros(3)), rgba)
            if panels:
                pale = rgba if len(panels) == 1 else (*(0.45 * np.array(rgba[:3]) + 0.55), 1.0)
                studio.add(_dots(poses.starts[poses.basin == k]), IDENTITY, pale)
            if len(panels) == 2 and cones[k].half_angle > 0:
                studio.add(_cap(cones[k].half_angle), pose_along(direction, np.zeros(3)), (*rgba[:3], 0.75))
        panels.append(captioned(studio.picture(camera, size, size), caption))
    return side_by_side(panels, 3)


def _camera(directions: Float[np.ndarray, "m 3"], half_angles: Float[np.ndarray, " m"]) -> Camera:
    """The camera that sees most of the cones, but not straight along an arrow."""
    views = fibonacci_sphere(400)
    views = views[np.abs(views[:, 2]) < 0.7]
    facing = views @ directions.T
    seen = (np.maximum(facing, 0.0) * np.where(facing < 0.93, 1.0, 0.3)) @ half_angles**0.5
    x, y, z = (_DISTANCE * views[seen.argmax()]).tolist()
    return Camera("c", (x, y, z), (0.0, 0.0, 0.0), 25.0)


def _stone() -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " 3"]]:
    rng = np.random.default_rng(17)
    points = rng.normal(size=(13, 3))
    points *= np.array([0.06, 0.05, 0.042]) / np.linalg.norm(points, axis=1, keepdims=True)
    return points, solid_center(points)


def _shipped(name: str) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " 3"]]:
    body = OBJECTS[name].body()
    return body.hull_vertices(), np.asarray(body.center_of_mass)


def _ball(radius: float) -> Look:
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 48)
    return revolve([(radius * np.cos(a), radius * np.sin(a)) for a in latitude], 96)


def _dots(directions: Float[np.ndarray, "k 3"]) -> Look:
    """Small discs on the unit sphere."""
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    discs: list[Look] = []
    for direction in directions:
        side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        side /= np.linalg.norm(side)
        ring = direction + _DOT * (np.outer(np.cos(turn), side) + np.outer(np.sin(turn), np.cross(direction, side)))
        faces = np.column_stack([np.zeros(10, int), np.arange(1, 11), np.arange(2, 12)])
        discs.append(Look(ring, faces, np.tile(direction, (12, 1))))
    return joined(discs)


def _cap(half_angle: float, radius: float = 1.01) -> Look:
    """The piece of a sphere within ``half_angle`` radians of z."""
    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    lean = np.linspace(half_angle, 0.0, 16)
    rings = np.stack(
        [np.column_stack([np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn), np.full(64, np.cos(a))]) for a in lean]
    )
    surface = grid_surface(radius * rings, wrap=True)
    return replace(surface, specular=0.1)
