"""The excavator alone in a simulation, for the tests of its model: posed, loaded, driven along ramps."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from robot_alone import at_rest

from regrasp_gym.robots.excavator import EXCAVATOR

CLOSED, OPEN = EXCAVATOR.theta_range
BODIES = ("chassis", "house", "boom", "arm", "tool_pitch", "tool_tilt", "tool_rotate", "gripper")
JAWS = ("left_jaw", "right_jaw")
FAR = np.array([0.0, -0.45, 0.75, np.pi / 2 - 0.3, 0.0, 0.0])
"""Stretched out, the grapple pointing down."""


def compiled(
    spec: mujoco.MjSpec | None = None, home: np.ndarray = EXCAVATOR.home
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The machine at rest with open jaws, commanded to stay there."""
    return at_rest(EXCAVATOR, spec, home)


def pose(data: mujoco.MjData, q: np.ndarray, theta: float) -> None:
    data.qpos[:6], data.qpos[6:8] = q, theta


def random_configurations(model: mujoco.MjModel, count: int) -> list[tuple[np.ndarray, float]]:
    rng = np.random.default_rng(0)
    low, high = model.jnt_range[:6].T
    return [(rng.uniform(low, high), rng.uniform(CLOSED, OPEN)) for _ in range(count)]


def loaded() -> mujoco.MjSpec:
    """The machine with a tonne fixed to its grapple."""
    spec = EXCAVATOR.build_spec()
    load = spec.body("gripper").add_body(name="load", pos=[0, 0, 1.22])
    load.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.35, 0.35, 0.4], mass=1000.0, contype=0, conaffinity=0)
    return spec


def ramp(distance: float, speed: float, acceleration: float) -> tuple[Callable[[float], float], float]:
    """Position over time of a move from rest to rest that reaches full speed, and its duration."""
    rise = speed / acceleration
    end = distance / speed + rise
    assert distance > speed * rise

    def position(time: float) -> float:
        if time > end - rise:
            return distance - 0.5 * acceleration * max(0.0, end - time) ** 2
        return speed * (time - rise / 2) if time > rise else 0.5 * acceleration * time**2

    return position, end
