"""Stand-ins for objects of the YCB set: their sizes and masses, simple convex shapes, no downloads.

Sizes are those of the published sheet or of the google_16k scans, masses those of the sheet: Calli, Walsman, Singh,
Srinivasa, Abbeel, Dollar, "Benchmarking in Manipulation Research", IEEE RAM 2015, doi 10.1109/MRA.2015.2448951.
"""

from __future__ import annotations

import numpy as np

from regrasp_gym.objects import shapes
from regrasp_gym.objects.model import ObjectModel, solid

_SCALE = 1e-3


def _box(name: str, label: str, mass: float, size: tuple[float, float, float], rgb: tuple[float, float, float]):
    points = shapes.box(*(np.array(size) * _SCALE))
    return solid(name, label, mass, [points], shape="box", rgba=(*rgb, 1.0))


def _mesh(name: str, label: str, mass: float, pieces: list[np.ndarray], rgb: tuple[float, float, float]):
    return solid(name, label, mass, [p * _SCALE for p in pieces], rgba=(*rgb, 1.0))


def _ball(name: str, label: str, mass: float, size: tuple[float, float, float], rgb: tuple[float, float, float]):
    return _mesh(name, label, mass, [shapes.flattened(shapes.ellipsoid(*size), 0.05 * size[2])], rgb)


def _banana() -> list[np.ndarray]:
    """Four pieces of an elliptic tube bent over 75°, lying on its side."""
    stations = np.linspace(-1, 1, 5)
    bend = np.deg2rad(75) * stations / 2
    radius = 190 / (2 * np.sin(np.deg2rad(75) / 2))
    half = np.interp(np.abs(stations), [0, 0.5, 1], [18.5, 17.0, 7.0])
    angle = 2 * np.pi * np.arange(8) / 8 + np.pi / 8
    rings = []
    for turn, r in zip(bend, half, strict=True):
        center = np.array([radius * (1 - np.cos(turn)), radius * np.sin(turn), 18.5])
        out = np.array([-np.cos(turn), np.sin(turn), 0.0])
        rings.append(center + r * (np.cos(angle)[:, None] * out + np.sin(angle)[:, None] * np.array([0, 0, 1.0])))
    return [np.concatenate(rings[i : i + 2]) for i in range(4)]


def _build() -> dict[str, ObjectModel]:
    s = shapes
    objects = [
        _box("003_cracker_box", "cracker box", 0.411, (71.8, 164, 213), (0.75, 0.1, 0.1)),
        _box("004_sugar_box", "sugar box", 0.514, (48, 93, 176), (0.95, 0.85, 0.2)),
        _mesh(
            "005_tomato_soup_can", "tomato soup can", 0.349, [s.lathe([(33.8, 0), (33.8, 102)], 24)], (0.8, 0.1, 0.1)
        ),
        _mesh(
            "006_mustard_bottle",
            "mustard bottle",
            0.603,
            [
                s.stacked([(90, 54, 24, 0), (96, 58, 26, 25), (94, 57, 26, 110), (40, 38, 19, 152)], 3),
                s.lathe([(18, 152), (16, 166), (8, 191)], 12),
            ],
            (0.95, 0.8, 0.05),
        ),
        _box("009_gelatin_box", "gelatin box", 0.097, (72.9, 89, 30), (0.7, 0.1, 0.15)),
        _mesh(
            "010_potted_meat_can",
            "potted meat can",
            0.370,
            [s.stacked([(102, 57.4, 17, 0), (102, 57.4, 17, 84)], 4)],
            (0.2, 0.3, 0.7),
        ),
        _mesh("011_banana", "banana", 0.066, _banana(), (0.95, 0.85, 0.15)),
        _mesh(
            "012_strawberry",
            "strawberry",
            0.018,
            [s.lathe([(8, 0), (16, 12), (21.5, 27), (21, 38), (9, 46)], 12)],
            (0.85, 0.1, 0.12),
        ),
        _ball("013_apple", "apple", 0.068, (75, 75, 75), (0.8, 0.1, 0.1)),
        _ball("014_lemon", "lemon", 0.029, (68, 54, 54), (0.98, 0.88, 0.15)),
        _ball("015_peach", "peach", 0.033, (60, 60, 60), (0.95, 0.6, 0.35)),
        _mesh(
            "016_pear",
            "pear",
            0.049,
            [s.lathe([(12, 0), (27, 9), (33, 29), (28, 52), (17, 78), (7, 96)], 10)],
            (0.6, 0.75, 0.2),
        ),
        _ball("017_orange", "orange", 0.047, (73, 73, 73), (0.98, 0.55, 0.05)),
        _ball("018_plum", "plum", 0.025, (56, 53, 53), (0.35, 0.05, 0.25)),
        _mesh(
            "021_bleach_cleanser",
            "bleach cleanser",
            1.131,
            [
                s.stacked([(96, 64, 24, 0), (102, 67.7, 27, 15), (100, 66, 27, 150), (46, 44, 21, 212)], 3),
                s.lathe([(20, 212), (19, 251)], 12),
            ],
            (0.93, 0.93, 0.95),
        ),
        _mesh(
            "040_large_marker",
            "large marker",
            0.0158,
            [s.along_y(s.lathe([(7, 0), (9.5, 6), (9.5, 115), (6, 121)], 12))],
            (0.1, 0.1, 0.1),
        ),
        _mesh(
            "043_phillips_screwdriver",
            "phillips screwdriver",
            0.097,
            [
                s.along_x(s.lathe([(12, 0), (17.5, 6), (17.5, 95), (11, 105)], 8)),
                s.along_x(s.lathe([(3.5, 105), (3.5, 208), (1, 215)], 8)),
            ],
            (0.85, 0.3, 0.1),
        ),
        _ball("055_baseball", "baseball", 0.138, (73, 73, 73), (0.93, 0.92, 0.88)),
        _ball("056_tennis_ball", "tennis ball", 0.058, (66.5, 66.5, 66.5), (0.8, 0.95, 0.2)),
        _ball("057_racquetball", "racquetball", 0.041, (55.5, 55.5, 55.5), (0.1, 0.25, 0.75)),
        _ball("058_golf_ball", "golf ball", 0.046, (42.6, 42.6, 42.6), (0.95, 0.95, 0.95)),
        _box("061_foam_brick", "foam brick", 0.028, (52, 78, 51), (0.65, 0.25, 0.2)),
        _mesh("065-a_cups", "orange cup", 0.013, [s.lathe([(28.5, 0), (22.5, 62)], 24)], (0.95, 0.45, 0.1)),
        _box("070-b_colored_wood_blocks", "colored wood block", 0.0108, (26, 26, 26), (0.1, 0.55, 0.25)),
        _box("077_rubiks_cube", "rubik's cube", 0.094, (57, 57, 57), (0.1, 0.1, 0.1)),
    ]
    return {thing.name: thing for thing in objects}


OBJECTS: dict[str, ObjectModel] = _build()
"""All stand-ins by name."""
