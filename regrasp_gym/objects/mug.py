"""Stand-in for the YCB mug, the only hollow object: ten pieces of wall, a floor and five pieces of handle.

Sizes in millimetres, from the google_16k scan: 93 across, 117 with the handle, 81 high; mass from the YCB sheet.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from regrasp_gym.objects.model import ObjectModel, solid
from regrasp_gym.rendering.surfaces import joined, revolve, sweep

_OUTER, _INNER, _HEIGHT = 46.5, 42.0, 81.0
_FLOOR = (1.0, 6.0)
_SECTORS = 10
_HALF_WIDTH = 6.5
_GLAZE = (0.62, 0.09, 0.1, 1.0)
_INSIDE = (0.93, 0.9, 0.86, 1.0)

# Corners (x, z) of the handle's inner and outer outline, from its upper to its lower end.
_INNER_LINE = ((0.0, 58.0), (9.5, 58.0), (14.3, 53.0), (14.3, 31.0), (9.5, 26.0), (0.0, 26.0))
_OUTER_LINE = ((0.0, 68.0), (15.3, 68.0), (24.5, 58.5), (24.5, 25.5), (15.3, 16.0), (0.0, 16.0))


def mug() -> ObjectModel:
    """The mug, standing upright with its handle towards +x."""
    scale = 1e-3
    face = _OUTER * np.cos(np.pi / (2 * _SECTORS))
    pieces = [*_wall(), _floor(), *_handle(face)]
    outside = revolve([(0, 1), (40, 1), (42, 0), (_OUTER - 1, 0), (_OUTER, 2), (_OUTER, 80), (45.5, 81)], smooth=False)
    # From the top down, so that the surface faces the axis.
    hollow = [(45.5, 81), (_INNER - 0.8, 80), (_INNER - 0.8, 9), (40, 6), (0, 6)]
    inside = revolve(hollow, smooth=False).painted(_INSIDE, 0.5, 0.6)
    line = 0.5 * (np.array(_INNER_LINE) + np.array(_OUTER_LINE))
    line[[0, -1], 0] = -1.5
    path = np.column_stack([line[:, 0] + face, np.zeros(len(line)), line[:, 1]])
    thick = np.column_stack([np.full(len(path), _HALF_WIDTH), np.full(len(path), 5.0)])
    handle = sweep(path, thick, np.array([0.0, 1.0, 0.0]), squareness=2.6, sides=16, ends=(False, False))
    shell = joined([outside, handle]).painted(_GLAZE, 0.6, 0.7)
    return solid(
        "025_mug",
        "mug",
        0.118,
        [piece * scale for piece in pieces],
        looks=[shell.stretched(scale), inside.stretched(scale)],
    )


def _wall() -> list[Float[np.ndarray, "10 3"]]:
    """Sectors of the wall: two flat facets outside, one inside. A facet is centred on +x, where the handle sits."""
    half = np.pi / (2 * _SECTORS)
    sectors: list[np.ndarray] = []
    for k in range(_SECTORS):
        start = half * (4 * k - 1)
        outer = start + 2 * half * np.arange(3)
        plan = np.concatenate([_around(_INNER, outer[[0, 2]]), _around(_OUTER, outer)])
        sectors.append(np.concatenate([np.column_stack([plan, np.full(5, z)]) for z in (0.0, _HEIGHT)]))
    return sectors


def _floor() -> Float[np.ndarray, "20 3"]:
    corners = _around(_INNER, np.pi / (2 * _SECTORS) * (4 * np.arange(_SECTORS) - 1))
    return np.concatenate([np.column_stack([corners, np.full(_SECTORS, z)]) for z in _FLOOR])


def _handle(face: float) -> list[Float[np.ndarray, "8 3"]]:
    inner, outer = np.array(_INNER_LINE), np.array(_OUTER_LINE)
    pieces: list[np.ndarray] = []
    for k in range(len(inner) - 1):
        side = np.concatenate([inner[k : k + 2], outer[k : k + 2]])
        pieces.append(
            np.concatenate(
                [np.column_stack([side[:, 0] + face, np.full(4, y), side[:, 1]]) for y in (-_HALF_WIDTH, _HALF_WIDTH)]
            )
        )
    return pieces


def _around(radius: float, angles: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])
