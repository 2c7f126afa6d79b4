"""The visible surfaces of the excavator's tracked undercarriage and its house."""

from __future__ import annotations

import numpy as np

from regrasp_gym.rendering.surfaces import Look, joined, sweep
from regrasp_gym.robots.excavator_shapes import bar, box, frustum, merged, pin, pipe, plate, stadium, strut
from regrasp_gym.robots.looks import Parts

_SHOES = 49
"""Shoes per track (Cat 320)."""

_GAUGE = 2.38
"""Distance between the centre lines of the tracks, metres (Cat 320)."""

_WHEELS = 1.80
"""Half the distance between sprocket and idler, metres (Cat 320: 3.65 m between them)."""


def chassis() -> Parts:
    """The undercarriage: two tracks, the frame between them and the slewing ring of the house."""
    frame = [
        frustum(_rectangle(1.0, 0.9), _rectangle(0.75, 0.7), 0.42, 0.86),
        *(strut((x, -1.1, 0.52), (x, 1.1, 0.52), 0.2, 0.13) for x in (-0.75, 0.75)),
    ]
    ring = pin((0, 0, 0.95), 0.68, 0.1, "z", 48)
    return merged({"dark": [*frame, ring]}, _track(_GAUGE / 2), _track(-_GAUGE / 2))


def _track(y: float) -> Parts:
    radius, middle = 0.41, 0.47
    belt = stadium(radius, _WHEELS, 140)
    path = np.array([(x, y, middle + z) for x, z, _ in [*belt, belt[0]]])
    chain = sweep(path, np.tile([0.1, 0.035], (len(path), 1)), np.array([0.0, 1.0, 0.0]), squareness=8.0, sides=16)
    shoes = [
        _shoe().rotated(_about_y(-turn)).shifted(np.array([x, y, middle + z]))
        for x, z, turn in stadium(radius + 0.04, _WHEELS, _SHOES)
    ]
    side = np.sign(y)
    sprocket = [pin((-_WHEELS, y, middle), 0.33, 0.06), pin((-_WHEELS, y + 0.17 * side, middle), 0.2, 0.11)]
    teeth = 21
    for angle in 2 * np.pi * np.arange(teeth) / teeth:
        tooth = plate([(0.31, -0.035), (0.4, -0.012), (0.4, 0.012), (0.31, 0.035)], -0.035, 0.035)
        sprocket.append(tooth.rotated(_about_y(angle)).shifted(np.array([-_WHEELS, y, middle])))
    idler = [pin((_WHEELS, y, middle), 0.37, 0.08), pin((_WHEELS, y, middle), 0.12, 0.2)]
    rollers = [pin((x, y, 0.19), 0.11, 0.19, sides=20) for x in np.linspace(-1.35, 1.35, 8)]
    carriers = [pin((x, y, 0.77), 0.08, 0.16, sides=20) for x in (-0.65, 0.65)]
    rail = plate([(-1.45, 0.24), (1.45, 0.24), (1.3, 0.56), (0.6, 0.66), (-0.6, 0.66), (-1.35, 0.58)], y - 0.2, y + 0.2)
    return {"track": [chain, *shoes], "dark": [rail, *idler], "steel": [*sprocket, *rollers, *carriers]}


def _shoe() -> Look:
    """A shoe with three grousers in the xy plane, facing down."""
    base = box((-0.095, -0.3, -0.018), (0.095, 0.3, 0.006))
    ridges = [box((x - 0.011, -0.3, -0.043), (x + 0.011, 0.3, -0.016)) for x in (-0.08, 0.0, 0.08)]
    return joined([base, *ridges])


def house() -> Parts:
    """The upper structure: deck, engine, counterweight, tanks, cab and the bracket of the boom."""
    return merged(_deck(), _engine(), _counterweight(), _right_side(), _cab(), _bracket())


def _deck() -> Parts:
    skirts = [box((-2.1, 1.3, 0.06), (1.22, 1.36, 0.26)), box((-2.1, -1.36, 0.06), (1.2, -1.3, 0.26))]
    return {"dark": [box((-2.2, -1.31, 0.03), (1.2, 1.31, 0.2))], "paint": skirts}


def _engine() -> Parts:
    side = [(-1.98, 0.2), (-0.42, 0.2), (-0.42, 1.12), (-0.5, 1.2), (-1.98, 1.2)]
    hood = [(-1.85, 1.15), (-0.65, 1.15), (-0.75, 1.29), (-1.85, 1.29)]
    louvres = [
        box((-1.8, y - 0.012, z), (-1.0, y + 0.012, z + 0.035)) for y in (1.345, -1.345) for z in _steps(0.45, 9)
    ]
    grille = [box((-1.7 + x, -0.5, 1.29), (-1.66 + x, 0.5, 1.3)) for x in np.linspace(0, 0.75, 9)]
    seams = [box((x, y - 0.006, 0.3), (x + 0.012, y + 0.006, 1.16)) for x in (-1.93, -0.92) for y in (1.346, -1.346)]
    band = [box((-1.93, y - 0.004, 0.98), (-0.45, y + 0.004, 1.08)) for y in (1.346, -1.346)]
    exhaust = pipe([(-1.0, -0.95, 1.15), (-1.0, -0.95, 1.48), (-1.06, -0.95, 1.56)], 0.06)
    rails = [pipe([(-1.9, y, 1.18), (-1.9, y, 1.46), (-0.6, y, 1.46), (-0.6, y, 1.18)], 0.018) for y in (1.2, -1.2)]
    body = [plate(side, -1.34, 1.34), plate(hood, -0.62, 0.62)]
    return {"paint": body, "cream": band, "dark": [*louvres, *grille, *seams, exhaust], "steel": rails}


def _counterweight() -> Parts:
    angles = np.linspace(-1, 1, 15) * np.arcsin(1.34 / 2.8)
    rear = [(-2.8 * np.cos(a), 2.8 * np.sin(a)) for a in angles]
    low = [*((x + 0.14, y * 0.99) for x, y in rear), (-1.95, 1.34), (-1.95, -1.34)]
    middle = [*rear, (-1.95, 1.35), (-1.95, -1.35)]
    high = [*((x + 0.1, y * 0.98) for x, y in rear), (-1.95, 1.34), (-1.95, -1.34)]
    eyes = [pin((-2.35, y, 1.12), 0.06, 0.03, "x") for y in (0.7, -0.7)]
    lamps = [box((-2.52, y - 0.1, 0.72), (-2.44, y + 0.1, 0.8)) for y in (1.05, -1.05)]
    body = [frustum(low, middle, 0.02, 0.2), frustum(middle, middle, 0.2, 0.92), frustum(middle, high, 0.92, 1.1)]
    return {"dark": [*body, *eyes], "lamp": lamps}


def _right_side() -> Parts:
    tank = [(-0.44, 0.2), (0.62, 0.2), (0.62, 0.8), (0.5, 0.9), (-0.44, 0.9)]
    step = box((0.62, -1.33, 0.2), (1.2, -0.43, 0.52))
    treads = [box((0.68, -1.3, 0.52), (1.18, -0.46, 0.53)), box((-0.35, -1.3, 0.9), (0.48, -0.46, 0.91))]
    rail = pipe(
        [(1.15, -1.28, 0.5), (1.15, -1.28, 0.95), (0.5, -1.28, 1.25), (-0.3, -1.28, 1.25), (-0.3, -1.28, 0.9)], 0.02
    )
    inner = pipe([(0.55, -1.28, 0.85), (0.55, -1.28, 1.23)], 0.018)
    lamp = box((1.2, -0.95, 0.36), (1.24, -0.78, 0.46))
    return {"paint": [plate(tank, -1.34, -0.42), step], "dark": treads, "steel": [rail, inner], "lamp": [lamp]}


def _cab() -> Parts:
    left, right = 1.33, 0.40
    sill, eave = 0.12, 1.80
    outline = [(-0.4, sill), (1.1, sill), (1.25, 0.7), (1.02, eave), (-0.4, eave)]
    inset = [(-0.37, sill + 0.03), (1.07, sill + 0.03), (1.215, 0.7), (0.995, eave), (-0.37, eave)]
    glass = plate(inset, right + 0.025, left - 0.025)
    low = [(-0.4, sill), (1.1, sill), (1.155, 0.34), (-0.4, 0.34)]
    lower = [plate(low, right, left)]
    door = plate([(-0.36, 0.34), (0.42, 0.34), (0.42, 0.72), (-0.36, 0.72)], left - 0.03, left)
    rear = box((-0.4, right, 0.34), (-0.365, left, 0.95))
    roof = [
        frustum(_span(-0.43, 1.1, right - 0.01, left + 0.01), _span(-0.36, 0.98, right + 0.06, left - 0.06), 1.78, 1.89)
    ]
    posts: list[Look] = []
    for y in (right + 0.03, left - 0.03):
        corner = [(x, y, z) for x, z in outline]
        posts += [strut(corner[k], corner[k + 1], 0.03, 0.035) for k in range(1, 3)]
        posts += [strut((-0.37, y, sill), (-0.37, y, eave), 0.03, 0.045)]
        posts += [
            strut((0.45, y, sill), (0.45, y, eave), 0.03, 0.028),
            strut((-0.4, y, 1.77), (1.03, y, 1.77), 0.03, 0.03),
        ]
    sills = [
        strut((1.24, right, 0.7), (1.24, left, 0.7), 0.02, 0.02),
        strut((1.03, right, 1.75), (1.03, left, 1.75), 0.03, 0.03),
    ]
    handle = pipe(
        [(0.52, left + 0.02, 0.8), (0.52, left + 0.05, 0.8), (0.52, left + 0.05, 1.25), (0.52, left + 0.02, 1.25)],
        0.012,
    )
    mirror = [
        bar((1.08, left, 1.5), (1.2, left + 0.1, 1.55), 0.012),
        box((1.17, left + 0.02, 1.36), (1.2, left + 0.2, 1.64)),
    ]
    lamps = [box((0.99, y - 0.07, 1.86), (1.06, y + 0.07, 1.94)) for y in (0.55, 1.18)]
    return {
        "glass": [glass],
        "paint": [*lower, door, rear],
        "cream": roof,
        "dark": [*posts, *sills, *mirror, handle],
        "lamp": lamps,
    }


def _bracket() -> Parts:
    outline = [(-0.45, 0.15), (1.02, 0.12), (0.98, 0.3), (0.42, 1.0), (0.24, 1.09), (0.06, 1.04), (-0.3, 0.55)]
    cheeks = [plate(outline, y - 0.03, y + 0.03) for y in (0.31, -0.31)]
    lugs = [plate([(0.5, 0.1), (0.9, 0.1), (0.8, 0.36), (0.64, 0.36)], y - 0.03, y + 0.03) for y in (0.43,)]
    pins = [pin((0.23, 0, 0.91), 0.08, 0.37), pin((0.72, 0, 0.28), 0.06, 0.48)]
    lugs += [plate([(0.5, 0.1), (0.9, 0.1), (0.8, 0.36), (0.64, 0.36)], -0.46, -0.4)]
    return {"paint": [*cheeks, *lugs], "steel": pins}


def _rectangle(half_x: float, half_y: float) -> list[tuple[float, float]]:
    return _span(-half_x, half_x, -half_y, half_y)


def _span(x0: float, x1: float, y0: float, y1: float) -> list[tuple[float, float]]:
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def _steps(start: float, count: int) -> list[float]:
    return [start + 0.055 * k for k in range(count)]


def _about_y(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
