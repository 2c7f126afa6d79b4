"""The Panda's outer shape: bent tubes, barrels at the joints and lofted housings, in white, grey and black."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from jaxtyping import Float

from regrasp_gym.rendering.surfaces import Look, Rgba, faceted, revolve, sweep
from regrasp_gym.robots.looks import Finish, Parts, RobotLooks, painted

WHITE: Rgba = (0.92, 0.93, 0.94, 1.0)
GREY: Rgba = (0.42, 0.44, 0.47, 1.0)
BLACK: Rgba = (0.09, 0.09, 0.10, 1.0)
STEEL: Rgba = (0.68, 0.69, 0.71, 1.0)

_X, _Y, _Z = np.eye(3)


_FINISHES: dict[str, Finish] = {
    "white": (WHITE, 0.5, 0.6),
    "grey": (GREY, 0.4, 0.5),
    "black": (BLACK, 0.3, 0.4),
    "steel": (STEEL, 0.7, 0.7),
}


@cache
def panda_looks() -> RobotLooks:
    """The Panda's visible surfaces."""
    parts = {
        "link0": _link0(),
        "link1": _link1(),
        "link2": _link2(),
        "link3": _link3(),
        "link4": _link4(),
        "link5": _link5(),
        "link6": _link6(),
        "link7": _link7(),
        "hand": _hand(),
        "left_finger": _finger(),
        "right_finger": _finger(),
    }
    return painted(parts, _FINISHES)


def _link0() -> Parts:
    height = np.array([0.0, 0.012, 0.03, 0.05, 0.075, 0.1, 0.12, 0.134])
    middle = np.array([-0.036, -0.036, -0.034, -0.028, -0.016, -0.006, -0.001, 0.0])
    half_x = np.array([0.104, 0.104, 0.102, 0.096, 0.082, 0.071, 0.066, 0.065])
    half_y = np.array([0.088, 0.088, 0.086, 0.081, 0.073, 0.067, 0.065, 0.065])
    path = np.column_stack([middle, np.zeros(8), height])
    foot = _loft(path, half_x, half_y, squareness=2.6)
    plate = _loft(path[:2], half_x[:2] + 0.002, half_y[:2] + 0.002, squareness=2.6)
    socket = faceted(_brick((0.012, 0.075, 0.05), (-0.136, 0, 0.042)))
    return {"white": [foot], "black": [plate, socket], "grey": [_ring(0.0655, 0.134, 0.141)]}


def _link1() -> Parts:
    column = _tube([(0, 0, -0.192), (0, 0, -0.12), (0, 0, -0.05), (0, 0, 0.0)], [0.0645, 0.062, 0.058, 0.05], _X)
    return {"white": [column, *_barrel((0, 0, 0), _Y, 0.0605, 0.062)]}


def _link2() -> Parts:
    arm = _tube([(0, 0, 0), (0, -0.05, 0), (0, -0.09, 0), (0, -0.124, 0)], [0.05, 0.056, 0.0605, 0.0625], _X)
    grey = [_turned(_ring(0.063, -0.004, 0.0), -_Y, (0, -0.124, 0))]
    return {"white": [arm, *_caps((0, 0, 0), _Z, 0.0585, 0.062)], "grey": grey + _rims((0, 0, 0), _Z, 0.0605, 0.062)}


def _link3() -> Parts:
    bend = _arc((0, 0, -0.188), (0, 0, -0.06), (0.03, 0, -0.012), (0.0825, 0, 0.0))
    shell = _tube(bend, np.interp(np.linspace(0, 1, len(bend)), [0, 0.3, 0.6, 1], [0.0625, 0.061, 0.06, 0.05]), _Y)
    return {"white": [shell, *_barrel((0.0825, 0, 0), _Y, 0.058, 0.060)]}


def _link4() -> Parts:
    bend = _arc((0, 0, 0), (-0.045, 0.02, 0), (-0.0825, 0.06, 0), (-0.0825, 0.122, 0))
    shell = _tube(bend, np.interp(np.linspace(0, 1, len(bend)), [0, 0.4, 0.7, 1], [0.05, 0.056, 0.0595, 0.0615]), _Z)
    grey = [_turned(_ring(0.062, 0.0, 0.004), _Y, (-0.0825, 0.122, 0)), *_rims((0, 0, 0), _Z, 0.058, 0.060)]
    return {"white": [shell, *_caps((0, 0, 0), _Z, 0.056, 0.060)], "grey": grey}


def _link5() -> Parts:
    height = np.array([-0.258, -0.235, -0.205, -0.17, -0.13, -0.09, -0.05, -0.015])
    back = np.array([0.0, 0.002, 0.012, 0.031, 0.05, 0.061, 0.066, 0.068])
    half_x = np.array([0.0615, 0.061, 0.058, 0.052, 0.047, 0.045, 0.044, 0.043])
    half_y = np.array([0.0615, 0.060, 0.056, 0.047, 0.038, 0.033, 0.031, 0.030])
    path = np.column_stack([np.zeros(8), back, height])
    forearm = _loft(path, half_x, half_y, squareness=2.2)
    return {
        "white": [
            forearm,
            *_barrel((0, 0.068, 0), _Y, 0.0475, 0.03),
            *_caps((0, 0.068, 0), _Y, 0.0455, 0.03, (False, True)),
        ],
        "grey": _rims((0, 0.068, 0), _Y, 0.0478, 0.0275),
    }


def _link6() -> Parts:
    neck = _tube(
        _arc((0, 0, 0.0), (0.03, 0, 0.004), (0.06, 0, 0.004), (0.088, 0, 0.0)), [0.044, 0.047, 0.048, 0.044], _Y
    )
    front = _caps((0, 0, 0.005), _Z, 0.0455, 0.04, (False, True))
    housing = _barrel((0.088, 0.004, 0), _Y, 0.0485, 0.05) + _caps((0.088, 0.004, 0), _Y, 0.0465, 0.05, (False, True))
    pads = faceted(_brick((0.03, 0.012, 0.02), (0.05, 0.047, 0.0)))
    return {
        "white": [neck, *_barrel((0, 0, 0.005), _Z, 0.0475, 0.04), *front, *housing],
        "grey": [*_rims((0, 0, 0.005), _Z, 0.0478, 0.039, (False, True)), pads],
    }


def _link7() -> Parts:
    cuff = _turned(
        revolve([(0, 0.046), (0.0455, 0.046), (0.0455, 0.078), (0.043, 0.086), (0, 0.086)], smooth=False), _Z
    )
    grip = _tube([(0, 0, 0.066), (0.022, 0.022, 0.068), (0.043, 0.043, 0.072)], [0.03, 0.028, 0.024], _Z)
    button = _turned(revolve([(0.021, 0), (0.021, 0.004), (0, 0.004)], smooth=False), _X + _Y, (0.043, 0.043, 0.072))
    flange = revolve([(0.0, 0.086), (0.0335, 0.086), (0.0335, 0.107), (0, 0.107)], smooth=False)
    return {"white": [cuff, grip], "black": [button], "grey": [flange]}


def _hand() -> Parts:
    height = np.array([0.0, 0.006, 0.014, 0.024, 0.036, 0.05])
    half_x = np.array([0.029, 0.0305, 0.0312, 0.0315, 0.0315, 0.0315])
    half_y = np.array([0.062, 0.082, 0.0935, 0.0995, 0.1015, 0.102])
    path = np.column_stack([np.zeros(6), np.zeros(6), height])
    shell = _loft(path, half_x, half_y, squareness=4.5)
    rail = _loft(
        np.array([[0, 0, 0.05], [0, 0, 0.062], [0, 0, 0.066]]),
        np.array([0.0305, 0.0305, 0.028]),
        np.array([0.101, 0.101, 0.097]),
        squareness=5.0,
    )
    slot = faceted(_brick((0.012, 0.19, 0.002), (0, 0, 0.066)))
    window = faceted(_brick((0.064, 0.05, 0.012), (0, 0, 0.033)))
    return {"white": [shell], "black": [rail, window], "grey": [slot]}


def _finger() -> Parts:
    mount = faceted(_brick((0.020, 0.014, 0.019), (0, 0.0185, 0.0105)))
    foot = faceted(_brick((0.020, 0.022, 0.005), (0, 0.0135, 0.0025)))
    diagonal = faceted(
        np.array(
            [
                [x, y, z]
                for x in (-0.0085, 0.0085)
                for y, z in ((0.012, 0.018), (0.0255, 0.018), (0.0152, 0.0405), (0.0065, 0.0375))
            ]
        )
    )
    tip = faceted(
        np.array(
            [
                [x, y, z]
                for x in (-0.00865, 0.00865)
                for y, z in ((0.0035, 0.036), (0.0152, 0.036), (0.0152, 0.048), (0.0085, 0.0544), (0.0035, 0.0544))
            ]
        )
    )
    rubber = faceted(_brick((0.0175, 0.0036, 0.0185), (0, 0.0018, 0.04525)))
    return {"steel": [mount, foot, diagonal, tip], "black": [rubber]}


def _loft(path: np.ndarray, half_x: np.ndarray, half_y: np.ndarray, squareness: float) -> Look:
    return sweep(path, np.column_stack([half_x, half_y]), _X, squareness=squareness, sides=36)


def _tube(
    points: Sequence[Sequence[float]] | np.ndarray, radii: Sequence[float] | np.ndarray, side: np.ndarray
) -> Look:
    """A round tube whose radii are spread evenly along ``points``."""
    points = np.asarray(points, float)
    along = np.interp(np.linspace(0, 1, len(points)), np.linspace(0, 1, len(radii)), radii)
    return sweep(points, np.column_stack([along, along]), side)


def _arc(*control: Sequence[float]) -> Float[np.ndarray, "k 3"]:
    """Nine points on the cubic Bézier curve of four control points."""
    a, b, c, d = (np.asarray(p, float) for p in control)
    t = np.linspace(0, 1, 9)[:, None]
    return (1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t**2 * (1 - t) * c + t**3 * d


def _turned(look: Look, axis: np.ndarray, at: Sequence[float] = (0, 0, 0)) -> Look:
    """``look`` with its z axis along ``axis`` and its origin at ``at``."""
    z = np.asarray(axis, float) / np.linalg.norm(axis)
    x = np.cross(_Y if abs(z[1]) < 0.9 else _X, z)
    x /= np.linalg.norm(x)
    return look.rotated(np.column_stack([x, np.cross(z, x), z])).shifted(np.asarray(at, float))


def _ring(radius: float, low: float, high: float) -> Look:
    return revolve([(0, low), (radius, low), (radius, high), (0, high)], smooth=False)


def _barrel(center: Sequence[float], axis: np.ndarray, radius: float, half: float) -> list[Look]:
    return [_turned(revolve([(radius, -half), (radius, half)]), axis, center)]


def _caps(
    center: Sequence[float], axis: np.ndarray, radius: float, half: float, sides: tuple[bool, bool] = (True, True)
) -> list[Look]:
    """Shallow domes on the ends of a barrel."""
    angle = np.linspace(0, np.pi / 2, 7)
    dome = revolve([(radius * np.cos(a), half + 0.022 * np.sin(a)) for a in angle])
    return [_turned(dome, axis * sign, center) for sign, there in zip((-1, 1), sides, strict=True) if there]


def _rims(
    center: Sequence[float], axis: np.ndarray, radius: float, half: float, sides: tuple[bool, bool] = (True, True)
) -> list[Look]:
    """Narrow rings around the ends of a barrel."""
    ring = _ring(radius, half - 0.001, half + 0.0055)
    return [_turned(ring, axis * sign, center) for sign, there in zip((-1, 1), sides, strict=True) if there]


def _brick(size: Sequence[float], center: Sequence[float]) -> Float[np.ndarray, "8 3"]:
    signs = np.array([[i, j, k] for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (-0.5, 0.5)])
    return signs * np.asarray(size) + np.asarray(center)
