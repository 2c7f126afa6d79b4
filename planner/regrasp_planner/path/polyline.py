"""Polylines in joint space, parametrised by chord length."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def chord_lengths(points: Float[np.ndarray, "K n"]) -> Float[np.ndarray, " K"]:
    """Length of the polyline up to each of its K points, from 0; radians (Euclidean) for configurations."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def points_at(points: Float[np.ndarray, "K n"], lengths: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N n"]:
    """Points of the polyline at the given lengths along it; the ends outside its length."""
    at = chord_lengths(points)
    return np.stack([np.interp(lengths, at, column) for column in points.T], axis=-1)


def inner_points(points: Float[np.ndarray, "K n"], count: int) -> Float[np.ndarray, "N n"]:
    """``count`` points evenly spaced along the polyline, its ends left out."""
    return points_at(points, np.linspace(0.0, chord_lengths(points)[-1], count + 2)[1:-1])
