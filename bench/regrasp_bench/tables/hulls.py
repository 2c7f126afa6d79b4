"""Random convex bodies."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from regrasp_gym.objects.model import ObjectModel, solid

STONE_DENSITY = 2600.0
"""Density of granite and limestone, kg/m³."""


def stone(seed: int) -> ObjectModel:
    """A random convex stone for the Panda: 12 to 60 vertices, 30 to 70 mm thick, up to three times as long and wide."""
    rng = np.random.default_rng([seed, 0x570E])
    points = random_hull(rng, int(rng.integers(12, 61)), roughness=0.1) * [1.0, *rng.uniform(1.0, 3.0, 2)]
    return stone_of(points * (rng.uniform(0.030, 0.070) / np.ptp(points[:, 0])), f"stone_{seed}")


def stone_of(points: Float[np.ndarray, "N 3"], name: str) -> ObjectModel:
    """The hull of the points (metres) as a solid of stone."""
    # Imported here because it loads JAX, which the physics alone does not need.
    from regrasp_planner.geometry.hull import mass_properties, qhull

    corners = qhull(points).vertices
    mass = STONE_DENSITY * mass_properties(points).volume
    return solid(name, name.replace("_", " "), mass, [points[corners]], rgba=(0.5, 0.48, 0.45, 1.0))


def random_hull(rng: np.random.Generator, count: int, roughness: float = 0.0) -> Float[np.ndarray, "N 3"]:
    """``count`` random points on the unit sphere, each pulled inwards by up to ``roughness``."""
    points = rng.normal(size=(count, 3))
    return points * (1 - roughness * rng.uniform(size=(count, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
