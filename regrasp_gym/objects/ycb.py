"""Stand-ins for YCB objects: published sizes and masses, simple shapes, no downloads.

Sizes are those of the published sheet or of the google_16k scans, masses those of the sheet: Calli, Walsman, Singh,
Srinivasa, Abbeel, Dollar, "Benchmarking in Manipulation Research", IEEE RAM 2015, doi 10.1109/MRA.2015.2448951.
Shapes are given in millimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from PIL import Image

from regrasp_gym.objects import prints, shapes
from regrasp_gym.objects.model import ObjectModel, solid
from regrasp_gym.objects.mug import mug
from regrasp_gym.objects.prints import Picture, Rgb, panel
from regrasp_gym.rendering.surfaces import Look, Rgba, faceted, joined, revolve, sweep, textured_box, wall

_MM = 1e-3
_TIN: Rgba = (0.78, 0.78, 0.76, 1.0)
_X, _Y, _Z = np.eye(3)
_TURN_X = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
_TURN_Y = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def _box(name: str, label: str, mass: float, size: tuple[float, float, float], texture: Picture) -> ObjectModel:
    full = np.array(size) * _MM
    return solid(name, label, mass, [shapes.box(*full)], shape="box", looks=[textured_box(full, texture)])


def _object(
    name: str, label: str, mass: float, pieces: Sequence[Float[np.ndarray, "N 3"]], looks: Sequence[Look]
) -> ObjectModel:
    return solid(name, label, mass, [p * _MM for p in pieces], looks=[look.stretched(_MM) for look in looks])


def _round(
    name: str, label: str, mass: float, size: tuple[float, float, float], skin: Picture, extra: Sequence[Look] = ()
) -> ObjectModel:
    """A ball or ellipsoid on a small flat base."""
    depth = 0.05 * size[2]
    pieces = [shapes.flattened(shapes.ellipsoid(*size), depth)]
    level = pieces[0][:, 2].min() * 2 / size[2]
    start = np.arcsin(max(level, -0.999))
    profile = [(0.0, np.sin(start)), *((np.cos(a), np.sin(a)) for a in np.linspace(start, np.pi / 2, 22))]
    ball = replace(revolve(profile, 36), texture=skin)
    return _object(name, label, mass, pieces, [ball.stretched(np.array(size) / 2), *extra])


def _can() -> ObjectModel:
    tomato = panel(
        1.1,
        (200, 25, 30),
        bands=((0.0, 0.04, (210, 210, 205)), (0.52, 1.0, (250, 248, 240)), (0.5, 0.53, (212, 170, 60))),
        text="TOMATO SOUP",
        at=0.28,
        disc=(0.72, 0.22, (205, 50, 35)),
    )
    side = revolve([(33.8, 3), (33.8, 99)], texture=prints.around(tomato, tomato))
    tin = revolve([(0, 0), (33.8, 0), (33.8, 3), (33.8, 3)], smooth=False)
    lid = revolve([(33.8, 99), (33.8, 102), (31.5, 102), (31.5, 100.5), (0, 100.5)], smooth=False)
    metal = joined([tin, lid]).painted(_TIN, 0.8, 0.8)
    return _object(
        "005_tomato_soup_can", "tomato soup can", 0.349, [shapes.lathe([(33.8, 0), (33.8, 102)], 24)], [side, metal]
    )


def _mustard() -> ObjectModel:
    body = [(90, 54, 24, 0), (96, 58, 26, 25), (94, 57, 26, 110), (40, 38, 17, 152)]
    neck = [(18, 152), (16, 166), (8, 191)]
    face = panel(
        1.05,
        (250, 205, 25),
        bands=((0.08, 0.9, (205, 30, 35)), (0.14, 0.84, (252, 240, 200))),
        text="MUSTARD",
        ink=(190, 25, 30),
        at=0.36,
        disc=(0.66, 0.16, (225, 160, 20)),
    )
    yellow = (0.97, 0.79, 0.08, 1.0)
    heights = np.array([0, 3, 12, 25, 60, 110, 124, 140, 152], float)
    shell = _bottle(body, heights).painted(yellow, 0.4, 0.5)
    label = _label((96.2, 58.4, 26), 35, 104, face, (248, 202, 20))
    cap = revolve([(18, 152), (17.5, 160), (15, 166), (9, 186), (7, 191), (0, 191)], smooth=False).painted(
        (0.85, 0.12, 0.1, 1.0), 0.4, 0.5
    )
    pieces = [shapes.stacked(body, 4), shapes.lathe(neck, 12)]
    return _object("006_mustard_bottle", "mustard bottle", 0.603, pieces, [shell, label, cap])


def _bleach() -> ObjectModel:
    body = [(96, 64, 24, 0), (102, 67.7, 27, 15), (100, 66, 27, 150), (46, 44, 21, 212)]
    face = panel(
        0.85,
        (30, 80, 165),
        bands=((0.0, 0.2, (235, 190, 30)), (0.62, 0.8, (245, 245, 245))),
        text="BLEACH CLEANSER",
        at=0.4,
        lines=(0.84, 0.97, (200, 215, 240)),
    )
    shell = _bottle(body, np.array([0, 4, 15, 60, 110, 150, 168, 190, 205, 212], float)).painted(
        (0.95, 0.95, 0.96, 1.0), 0.4, 0.5
    )
    label = _label((102.2, 68.0, 27), 28, 142, face, (242, 242, 245))
    cap = revolve([(20, 212), (20, 240), (19, 251), (0, 251)], smooth=False).painted((0.12, 0.3, 0.68, 1.0), 0.4, 0.5)
    pieces = [shapes.stacked(body), shapes.lathe([(20, 212), (19, 251)], 12)]
    return _object("021_bleach_cleanser", "bleach cleanser", 1.131, pieces, [shell, label, cap])


def _meat_can() -> ObjectModel:
    section = (102, 57.4, 17)
    front = panel(
        1.2,
        (25, 45, 125),
        bands=((0.0, 0.05, (205, 205, 200)), (0.68, 0.95, (240, 190, 40)), (0.95, 1.0, (205, 205, 200))),
        text="POTTED MEAT",
        at=0.36,
        ink=(250, 225, 90),
    )
    pieces = [shapes.stacked([(*section, 0), (*section, 84)], 4)]
    side = _label(section, 2, 82, front, (25, 45, 125))
    rim = [wall(shapes.rounded_rectangle(*section, 9), *span) for span in ((0, 2), (82, 84))]
    metal = joined([faceted(pieces[0] * [0.995, 0.995, 1.0]), *rim]).painted(_TIN, 0.8, 0.8)
    return _object("010_potted_meat_can", "potted meat can", 0.370, pieces, [side, metal])


def _banana() -> ObjectModel:
    """Four pieces of an octagonal tube bent over 75°, lying on its side."""
    stations, arc = np.linspace(-1, 1, 5), np.deg2rad(75)
    radius = 190 / (2 * np.sin(arc / 2))

    def path(s: np.ndarray) -> np.ndarray:
        turn = arc * s / 2
        return np.column_stack([radius * (1 - np.cos(turn)), radius * np.sin(turn), np.full(len(s), 17.1)])

    half = np.interp(np.abs(stations), [0, 0.5, 1], [18.5, 18.5, 9.0])
    angle = 2 * np.pi * np.arange(8) / 8 + np.pi / 8
    rings = []
    for center, turn, r in zip(path(stations), arc * stations / 2, half, strict=True):
        out = np.array([-np.cos(turn), np.sin(turn), 0.0])
        rings.append(center + r * (np.cos(angle)[:, None] * out + np.sin(angle)[:, None] * _Z))
    fine = np.linspace(-1, 1, 17)
    width = np.interp(np.abs(fine), [0, 0.5, 0.85, 0.95, 1], [17.8, 17.6, 12.0, 9.0, 6.0])
    peel = sweep(path(fine), np.column_stack([width, width]), _Z, squareness=2.3, sides=20)
    stem = sweep(path(np.array([0.97, 1.0, 1.05])), np.array([[6.2, 6.2], [4.5, 4.5], [4.0, 4.0]]), _Z, sides=10)
    tip = sweep(path(np.array([-1.012, -1.0, -0.96])), np.array([[2.0, 2.0], [6.1, 6.1], [8.6, 8.6]]), _Z, sides=12)
    brown = joined([stem, tip]).painted((0.32, 0.24, 0.1, 1.0), 0.1, 0.1)
    pieces = [np.concatenate(rings[i : i + 2]) for i in range(4)]
    return _object("011_banana", "banana", 0.066, pieces, [peel.painted((0.96, 0.82, 0.16, 1.0), 0.2, 0.3), brown])


def _strawberry() -> ObjectModel:
    pieces = [shapes.lathe([(11, 0), (17, 10), (22, 27), (21.5, 38), (9, 46)], 12)]
    skin = prints.dotted((205, 25, 35), (240, 200, 110), 120, 0.05)
    flesh = revolve(
        [(0, 0), (10, 0), (14, 5), (17.5, 12), (20.4, 20), (21.4, 28), (21, 37), (17, 43), (9, 45)], 24, texture=skin
    )
    leaf = revolve([(20, 41.5), (13, 45.4), (3, 46), (2, 47), (0, 47)], 7, smooth=False).painted(
        (0.2, 0.5, 0.15, 1.0), 0.1, 0.2
    )
    return _object("012_strawberry", "strawberry", 0.018, pieces, [flesh, leaf])


def _pear() -> ObjectModel:
    pieces = [shapes.lathe([(12, 0), (28, 9), (34.5, 29), (29, 52), (17, 78), (7, 96)], 10)]
    skin = prints.blended((190, 190, 70), (150, 185, 60), (205, 175, 80), 16, 0.03)
    flesh = revolve(
        [
            (0, 0),
            (12, 0),
            (20, 4),
            (28.5, 12),
            (33.6, 27),
            (32, 42),
            (26.5, 56),
            (18.5, 74),
            (14, 88),
            (7, 95),
            (0, 96),
        ],
        30,
        texture=skin,
    )
    return _object("016_pear", "pear", 0.049, pieces, [flesh, _stem(94, 104)])


def _marker() -> ObjectModel:
    pieces = [shapes.along_y(shapes.lathe([(7, 0), (9.5, 6), (9.5, 115), (6, 121)], 12))]
    body = revolve([(0, 0), (7, 0), (9.2, 5), (9.2, 38), (9.5, 38), (9.5, 115), (6, 121), (0, 121)], smooth=False)
    band = revolve([(9.6, 46), (9.6, 108)])
    black = body.rotated(_TURN_Y).painted((0.07, 0.07, 0.08, 1.0), 0.5, 0.6)
    white = band.rotated(_TURN_Y).painted((0.93, 0.93, 0.93, 1.0), 0.4, 0.5)
    return _object("040_large_marker", "large marker", 0.0158, pieces, [black, white])


def _screwdriver() -> ObjectModel:
    handle = [(12, 0), (17.5, 6), (17.5, 95), (11, 105)]
    pieces = [
        shapes.along_x(shapes.lathe(handle, 8)),
        shapes.along_x(shapes.lathe([(3.5, 105), (3.5, 208), (1, 215)], 8)),
    ]
    grip = (
        faceted(shapes.lathe([(17.6, 20), (17.6, 88)], 8)).rotated(_TURN_X).painted((0.08, 0.08, 0.09, 1.0), 0.3, 0.4)
    )
    core = faceted(shapes.lathe(handle, 8)).rotated(_TURN_X).painted((0.85, 0.2, 0.08, 1.0), 0.6, 0.7)
    steel = revolve([(3.5, 104), (3.5, 208), (1, 215), (0, 215)], 16).rotated(_TURN_X).painted(_TIN, 0.9, 0.9)
    return _object("043_phillips_screwdriver", "phillips screwdriver", 0.097, pieces, [core, grip, steel])


def _cup() -> ObjectModel:
    profile = [
        (0, 1),
        (26, 1),
        (28.5, 0),
        (28.5, 4),
        (27.6, 4),
        (25.2, 50),
        (25.6, 51),
        (23.0, 60),
        (21.0, 62),
        (0, 62),
    ]
    shell = revolve(profile, smooth=False).painted((0.95, 0.42, 0.08, 1.0), 0.5, 0.6)
    return _object("065-a_cups", "orange cup", 0.013, [shapes.lathe([(28.5, 0), (22.5, 62)], 24)], [shell])


def _bottle(sections: Sequence[tuple[float, float, float, float]], heights: np.ndarray) -> Look:
    """Smooth shell through the rounded rectangles of a bottle."""
    x, y, _, z = np.array(sections).T
    half = np.column_stack([np.interp(heights, z, x), np.interp(heights, z, y)]) / 2
    path = np.column_stack([np.zeros((len(heights), 2)), heights])
    return sweep(path, half, _X, squareness=2.6, sides=40)


def _label(section: tuple[float, float, float], low: float, high: float, face: Picture, ground: Rgb) -> Look:
    """A printed band around a rounded rectangle (x, y, corner radius), with ``face`` on both broad sides (±y)."""
    outline = shapes.rounded_rectangle(*section, 9)
    outline = np.vstack([[section[0] / 2, 0.0], outline])
    perimeter = np.linalg.norm(np.diff(np.vstack([outline, outline[:1]]), axis=0), axis=1).sum()
    half = 2 * prints.TILE
    width = round(2 * half * 0.85 * section[0] / perimeter)
    margin = (half - width) // 2
    image = np.asarray(Image.fromarray(face).resize((width, prints.TILE)))
    left, right = (panel(0.5, ground, size=(w, prints.TILE)) for w in (margin, half - width - margin))
    return wall(outline, low, high, prints.around(left, image, right, left, image, right))


def _stem(low: float, high: float) -> Look:
    path = np.array([[0, 0, low], [0.5, 0, (low + high) / 2], [2.0, 0, high]])
    return sweep(path, np.full((3, 2), 1.6), _Y, sides=8).painted((0.35, 0.25, 0.12, 1.0), 0.1, 0.1)


def _boxes() -> list[ObjectModel]:
    red, cream = (190, 25, 35), (250, 240, 205)
    cracker = prints.atlas(
        panel(
            0.77,
            red,
            bands=((0.62, 1.0, (245, 200, 60)),),
            text="CRUNCHY CRACKERS",
            at=0.25,
            disc=(0.72, 0.27, (215, 160, 80)),
        ),
        panel(0.34, red, bands=((0.3, 0.95, cream),), lines=(0.36, 0.9, (120, 90, 60))),
        panel(0.44, red, bands=((0.25, 0.75, cream),)),
    )
    sugar = prints.atlas(
        panel(
            0.53,
            (250, 215, 40),
            bands=((0.55, 1.0, (250, 250, 248)), (0.52, 0.56, (30, 70, 160))),
            text="PURE SUGAR",
            at=0.28,
            ink=(25, 60, 150),
            disc=(0.77, 0.2, (215, 225, 240)),
        ),
        panel(0.27, (250, 215, 40), bands=((0.55, 1.0, (250, 250, 248)),), lines=(0.6, 0.95, (150, 160, 190))),
        panel(0.52, (250, 215, 40)),
    )
    gelatin = prints.atlas(
        panel(3.0, (200, 30, 55)),
        panel(2.4, (200, 30, 55), text="GELATIN", at=0.5),
        panel(
            0.82,
            (200, 30, 55),
            bands=((0.5, 0.95, (250, 235, 225)),),
            text="GELATIN",
            at=0.27,
            disc=(0.72, 0.18, (230, 60, 80)),
        ),
    )
    foam = prints.speckled((165, 62, 48), 0.03, 61, (3 * prints.TILE, 2 * prints.TILE))
    wood = prints.speckled((35, 140, 70), 0.012, 70, (3 * prints.TILE, 2 * prints.TILE))
    return [
        _box("003_cracker_box", "cracker box", 0.411, (71.8, 164, 213), cracker),
        _box("004_sugar_box", "sugar box", 0.514, (48, 93, 176), sugar),
        _box("009_gelatin_box", "gelatin box", 0.097, (72.9, 89, 30), gelatin),
        _box("061_foam_brick", "foam brick", 0.028, (52, 78, 51), foam),
        _box("070-b_colored_wood_blocks", "colored wood block", 0.0108, (26, 26, 26), wood),
        _box("077_rubiks_cube", "rubik's cube", 0.094, (57, 57, 57), prints.rubiks_cube()),
    ]


def _balls() -> list[ObjectModel]:
    p = prints
    return [
        _round(
            "013_apple",
            "apple",
            0.068,
            (75, 75, 75),
            p.blended((170, 30, 30), (185, 35, 35), (225, 170, 60), 13),
            [_stem(34, 42)],
        ),
        _round("014_lemon", "lemon", 0.029, (68, 54, 54), p.speckled((250, 220, 50), 0.02, 14)),
        _round(
            "015_peach", "peach", 0.033, (60, 60, 60), p.blended((240, 170, 90), (245, 180, 100), (215, 70, 55), 15)
        ),
        _round("017_orange", "orange", 0.047, (73, 73, 73), p.speckled((245, 140, 20), 0.03, 17)),
        _round("018_plum", "plum", 0.025, (56, 53, 53), p.blended((70, 20, 60), (90, 25, 70), (150, 40, 80), 18)),
        _round(
            "055_baseball", "baseball", 0.138, (73, 73, 73), p.stitched((240, 237, 228), (190, 30, 40), 0.055, True)
        ),
        _round(
            "056_tennis_ball",
            "tennis ball",
            0.058,
            (66.5, 66.5, 66.5),
            p.stitched((200, 225, 60), (245, 245, 240), 0.05, False),
        ),
        _round("057_racquetball", "racquetball", 0.041, (55.5, 55.5, 55.5), p.speckled((30, 70, 185), 0.01, 57)),
        _round(
            "058_golf_ball",
            "golf ball",
            0.046,
            (42.6, 42.6, 42.6),
            p.dotted((245, 245, 245), (205, 208, 212), 200, 0.065),
        ),
    ]


def _build() -> dict[str, ObjectModel]:
    things = [
        *_boxes(),
        *_balls(),
        _can(),
        _mustard(),
        _meat_can(),
        _banana(),
        _strawberry(),
        _pear(),
        _bleach(),
        _marker(),
        _screwdriver(),
        _cup(),
        mug(),
    ]
    return {thing.name: thing for thing in sorted(things, key=lambda thing: thing.name)}


OBJECTS: dict[str, ObjectModel] = _build()
"""All stand-ins by name."""
