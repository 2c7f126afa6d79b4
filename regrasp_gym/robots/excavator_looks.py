"""The excavator's visible surfaces: boom, arm, tiltrotator and grapple; the rest is in excavator_carrier_looks.py."""

from __future__ import annotations

from functools import cache

import numpy as np

from regrasp_gym.rendering.surfaces import Look, revolve
from regrasp_gym.robots import excavator_carrier_looks as carrier
from regrasp_gym.robots.excavator_shapes import FINISHES, bar, beam, box, frustum, merged, pin, pipe, plate
from regrasp_gym.robots.looks import Parts, RobotLooks, painted


@cache
def excavator_looks() -> RobotLooks:
    """The excavator's visible surfaces."""
    parts = {
        "chassis": carrier.chassis(),
        "house": carrier.house(),
        "boom": _boom(),
        "arm": _arm(),
        "tool_pitch": _tool_pitch(),
        "tool_tilt": _tool_tilt(),
        "tool_rotate": _tool_rotate(),
        "gripper": _palm(),
        "left_jaw": _jaw(),
        "right_jaw": _jaw(),
    }
    return painted(parts, FINISHES)


def _boom() -> Parts:
    line = [(-0.05, -0.02), (0.5, 0.21), (1.2, 0.48), (1.8, 0.66), (2.3, 0.73), (2.8, 0.68), (3.6, 0.49), (4.7, 0.22)]
    line += [(5.45, 0.05)]
    heights = [0.16, 0.22, 0.29, 0.33, 0.35, 0.33, 0.28, 0.22, 0.16]
    fork = [
        plate([(5.2, -0.06), (5.2, 0.22), (5.75, 0.14), (5.84, 0.0), (5.75, -0.14)], y - 0.025, y + 0.025)
        for y in (0.215, -0.215)
    ]
    lug = [plate([(2.45, 0.95), (2.62, 1.22), (2.78, 1.22), (2.95, 0.9)], y - 0.02, y + 0.02) for y in (0.1, -0.1)]
    bosses = [pin((0, 0, 0), 0.16, 0.27), pin((2.15, 0, 0.42), 0.11, 0.26)]
    pins = [pin((2.15, 0, 0.42), 0.06, 0.45), pin((2.7, 0, 1.16), 0.05, 0.14), pin((5.7, 0, 0), 0.09, 0.27)]
    barrels: list[Look] = []
    caps: list[Look] = []
    down = np.array([-0.875, 0.0, -0.485])
    for y in (0.36, -0.36):
        top = np.array([2.15, y, 0.42])
        barrels.append(bar(top - 0.03 * down, top + 1.3 * down, 0.085, 24))
        caps.append(bar(top + 1.28 * down, top + 1.37 * down, 0.095, 24))
        caps.append(pin(top, 0.1, 0.06))
    toward = np.array([0.989, 0.0, -0.148])
    base = np.array([2.7, 0.0, 1.16])
    barrels.append(bar(base, base + 1.75 * toward, 0.09, 24))
    caps += [bar(base + 1.72 * toward, base + 1.82 * toward, 0.1, 24), pin(base, 0.1, 0.07)]
    hoses = [
        pipe(
            [
                (0.35, y, 0.42),
                (1.1, y, 0.78),
                (1.8, y, 1.02),
                (2.3, y, 1.1),
                (2.8, y, 1.03),
                (3.6, y, 0.79),
                (5.2, y, 0.36),
            ],
            0.022,
        )
        for y in (0.15, 0.09, -0.15)
    ]
    stripe = [plate([(3.1, 0.52), (4.6, 0.15), (4.6, 0.27), (3.1, 0.7)], y - 0.003, y + 0.003) for y in (0.208, -0.208)]
    lamp = box((2.02, 0.24, 0.74), (2.12, 0.32, 0.82))
    return {
        "paint": [beam(line, heights, 0.205), *fork, *lug, *bosses],
        "cream": stripe,
        "dark": [*barrels, *hoses],
        "steel": [*pins, *caps],
        "lamp": [lamp],
    }


def _arm() -> Parts:
    outline = [(-0.8, 0.4), (-0.72, 0.51), (-0.55, 0.5), (0.35, 0.43), (1.0, 0.34), (2.9, 0.12), (3.0, 0.05)]
    outline += [(2.96, -0.1), (1.2, -0.13), (0.05, -0.17), (-0.15, -0.1)]
    bosses = [pin((0, 0, 0), 0.16, 0.185), pin((2.9, 0, 0), 0.125, 0.18)]
    pins = [pin((-0.7, 0, 0.42), 0.05, 0.19), pin((0.3, 0, 0.54), 0.05, 0.14), pin((2.62, 0, 0.52), 0.05, 0.2)]
    pins += [pin((2.9, 0, 0), 0.065, 0.25), pin((2.45, 0, 0.08), 0.05, 0.2)]
    lug = [plate([(0.1, 0.4), (0.22, 0.6), (0.38, 0.6), (0.5, 0.38)], y - 0.02, y + 0.02) for y in (0.1, -0.1)]
    levers = [plate([(2.4, 0.05), (2.5, 0.05), (2.68, 0.54), (2.57, 0.58)], y - 0.02, y + 0.02) for y in (0.15, -0.15)]
    barrel = bar((0.3, 0, 0.54), (1.75, 0, 0.5275), 0.075, 24)
    caps = [bar((1.73, 0, 0.5277), (1.82, 0, 0.527), 0.085, 24), pin((0.3, 0, 0.54), 0.085, 0.07)]
    rod = bar((1.8, 0, 0.527), (2.62, 0, 0.52), 0.042, 20)
    hoses = [
        pipe([(-0.5, y, 0.5), (0.0, y, 0.5), (0.9, y, 0.4), (2.3, y, 0.24), (2.8, y, 0.2)], 0.02) for y in (0.12, -0.12)
    ]
    return {
        "paint": [plate(outline, -0.16, 0.16), *bosses, *lug],
        "dark": [barrel, *levers, *hoses],
        "steel": [*pins, *caps],
        "chrome": [rod],
    }


def _tool_pitch() -> Parts:
    ears = [
        plate(
            [(-0.44, -0.07), (-0.3, -0.09), (0.06, -0.1), (0.12, 0.0), (0.16, 0.1), (-0.42, 0.1)], y - 0.025, y + 0.025
        )
        for y in (0.16, -0.16)
    ]
    base = box((-0.42, -0.185, 0.07), (0.16, 0.185, 0.12))
    yokes = [
        plate([(-0.16, 0.1), (0.16, 0.1), (0.08, 0.32), (-0.08, 0.32)], x - 0.025, x + 0.025, "x")
        for x in (0.13, -0.39)
    ]
    pins = [pin((-0.36, 0, 0), 0.055, 0.21), pin((0, 0, 0), 0.1, 0.135)]
    return {"cream": [*ears, base, *yokes], "steel": pins}


def _tool_tilt() -> Parts:
    shaft = [pin((-0.13, 0, 0), 0.095, 0.235, "x"), pin((-0.13, 0, 0), 0.06, 0.31, "x")]
    housing = frustum(
        [(-0.33, -0.13), (0.08, -0.13), (0.08, 0.13), (-0.33, 0.13)],
        [(-0.27, -0.2), (0.18, -0.2), (0.18, 0.2), (-0.27, 0.2)],
        -0.02,
        0.13,
    )
    cylinders = [bar((-0.13, y, -0.12), (-0.13, y * 1.05, 0.12), 0.05, 20) for y in (0.23, -0.23)]
    return {"paint": [housing], "steel": shaft[:1], "dark": [*cylinders], "chrome": shaft[1:]}


def _tool_rotate() -> Parts:
    drum = revolve([(0, -0.13), (0.22, -0.13), (0.22, -0.05), (0.26, -0.05), (0.26, 0.02), (0, 0.02)], 44, smooth=False)
    flange = revolve([(0, 0.02), (0.21, 0.02), (0.21, 0.07), (0.25, 0.07), (0.25, 0.13), (0, 0.13)], 44, smooth=False)
    motor = pin((0.2, 0.12, -0.06), 0.06, 0.07, "z", 20)
    bolts = [
        pin((0.235 * np.cos(a), 0.235 * np.sin(a), 0.135), 0.014, 0.012, "z", 8)
        for a in np.linspace(0, 2 * np.pi, 13)[:-1]
    ]
    return {"dark": [drum, motor], "steel": [flange, *bolts]}


def _palm() -> Parts:
    top = [(-0.2, -0.26), (0.2, -0.26), (0.2, 0.26), (-0.2, 0.26)]
    wide = [(-0.2, -0.47), (0.2, -0.47), (0.2, 0.47), (-0.2, 0.47)]
    low = [(-0.17, -0.42), (0.17, -0.42), (0.17, 0.42), (-0.17, 0.42)]
    body = [frustum(top, wide, 0.0, 0.2), frustum(wide, low, 0.2, 0.36)]
    ears = [
        plate(
            [(y - 0.2 * s, 0.16), (y + 0.06 * s, 0.22), (y + 0.09 * s, 0.323), (y, 0.42), (y - 0.2 * s, 0.36)],
            x - 0.02,
            x + 0.02,
            "x",
        )
        for s, y in ((1, 0.52), (-1, -0.52))
        for x in (0.165, -0.165)
    ]
    pins = [pin((0, y, 0.323), 0.06, 0.215, "x") for y in (0.52, -0.52)]
    ram = [bar((x, -0.36, 0.13), (x, 0.36, 0.13), 0.05, 20) for x in (0.215, -0.215)]
    return merged({"paint": [*body, *ears], "steel": pins}, {"dark": ram})


def _jaw() -> Parts:
    rib = [
        (-0.05, -0.09),
        (0.08, -0.1),
        (0.13, 0.2),
        (0.11, 0.7),
        (0.09, 0.95),
        (-0.03, 0.9),
        (0.0, 0.8),
        (-0.055, 0.1),
    ]
    ribs = [plate(rib, x - 0.02, x + 0.02, "x") for x in (-0.11, 0.11)]
    back = [box((-0.13, 0.07, 0.12), (0.13, 0.11, 0.9))]
    hinge = pin((0, 0, 0), 0.095, 0.14, "x")
    core = pin((0, 0, 0.9), 0.085, 0.12, "x")
    teeth: list[Look] = []
    for turn in np.arange(0, 2 * np.pi, np.pi / 8):
        c, s = np.cos(turn), np.sin(turn)
        corners = np.array([(0.08, -0.014), (0.08, 0.014), (0.1, 0.0)]) @ np.array([[c, s], [-s, c]])
        teeth += [plate([(y, 0.9 + z) for y, z in corners], x - 0.04, x + 0.04, "x") for x in (-0.08, 0.0, 0.08)]
    dome = revolve([(0.0975 * np.cos(a), 0.0975 * np.sin(a)) for a in np.linspace(0, np.pi / 2, 7)], 28)
    tips = [
        dome.rotated(np.array([[0, 0, s], [0, 1, 0], [-s, 0, 0]], float)).shifted(np.array([0.12 * s, 0, 0.9]))
        for s in (-1, 1)
    ]
    return {"paint": [*ribs, *back], "steel": [hinge, core, *tips, *teeth]}
