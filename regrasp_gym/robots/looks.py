"""The visible surfaces of a robot: painted by finish and added to its specification."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from regrasp_gym.rendering.surfaces import Look, Rgba, add_look, joined

Parts = dict[str, list[Look]]
"""Surfaces of one body by the name of their finish."""

Finish = tuple[Rgba, float, float]
"""Colour, specular and shininess."""

RobotLooks = dict[str, dict[str, Look]]
"""Painted surfaces by body and finish, each in the frame of its body."""


def painted(bodies: Mapping[str, Parts], finishes: Mapping[str, Finish]) -> RobotLooks:
    """Join the surfaces of each body and finish into one, and paint it."""
    return {
        body: {finish: joined(surfaces).painted(*finishes[finish]) for finish, surfaces in parts.items()}
        for body, parts in bodies.items()
    }


def add_looks(spec: mujoco.MjSpec, looks: RobotLooks) -> None:
    """Add the visible geoms (group 2), named ``{body}_{finish}``, to the bodies of a specification."""
    for body, surfaces in looks.items():
        for finish, look in surfaces.items():
            add_look(spec, spec.body(body), f"{body}_{finish}", look)
