"""Visible surfaces of stones: rough facets with chipped edges, in muted colours."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float, UInt8

from regrasp_gym.rendering.surfaces import Look

TONES: dict[str, tuple[float, float, float]] = {
    "light grey": (0.80, 0.80, 0.78),
    "dark grey": (0.42, 0.42, 0.42),
    "brown": (0.52, 0.45, 0.37),
    "reddish": (0.66, 0.53, 0.48),
    "sandy": (0.81, 0.73, 0.60),
    "greenish": (0.55, 0.59, 0.51),
}
"""Colours by name; each stone's colour varies around its tone."""

ROUGHNESS = 0.014
"""Greatest depth of the surface inside the polyhedron away from edges, metres. It is never outside."""

_CHIP = 0.009
"""Extra depth along the edges, metres."""

_SEGMENTS = 3
"""Segments per edge."""

_GRAINS = 8
_TEXELS = 160
_TEXTURE_SPAN = 1.7
"""Width of the texture on the stone, metres: more than a stone's extent, so that coordinates stay in [0, 1]."""


def rough_stone(
    rng: np.random.Generator, triangles: Float[np.ndarray, "T 3 3"], normals: Float[np.ndarray, "T 3"], tone: str
) -> Look:
    """The surface of a convex stone.

    Args:
        rng: draws the roughness, the texture and the deviation from the tone.
        triangles: (T, 3, 3) start and end of each edge of each facet, counter-clockwise from outside, and the facet's
            middle, about the origin, metres.
        normals: (T, 3) unit outward normals of the facets.
        tone: key of `TONES`.
    """
    waves = rng.normal(size=(9, 3))
    waves *= (np.geomspace(5.0, 34.0, 9) / np.linalg.norm(waves, axis=1))[:, None]
    phases = rng.uniform(0, 2 * np.pi, 9)
    heights = 1 / np.linalg.norm(waves, axis=1) ** 0.8
    heights *= 0.5 * ROUGHNESS / heights.sum()
    grid, small = _broken_triangle(_SEGMENTS)
    points = np.einsum("pc,tcx->tpx", grid, triangles)
    outward = np.repeat(normals[:, None], len(grid), axis=1)
    phase = points @ waves.T + phases
    depth = 0.5 * ROUGHNESS + np.sin(phase) @ heights
    gradient = (np.cos(phase) * heights) @ waves
    on_edge = grid[:, 2] == 0
    depth = depth + _CHIP * on_edge
    radial = points / np.linalg.norm(points, axis=2, keepdims=True)
    # The gradient is exaggerated to shade the roughness that the few faces cannot show.
    tilt = gradient - np.einsum("tpx,tpx->tp", gradient, outward)[..., None] * outward
    turned = outward + 2.6 * tilt
    turned = np.where(on_edge[:, None], turned + 0.55 * radial, turned)
    turned /= np.linalg.norm(turned, axis=2, keepdims=True)
    count = len(triangles) * len(grid)
    faces = (np.arange(len(triangles))[:, None, None] * len(grid) + small).reshape(-1, 3)
    colour = np.clip(np.array(TONES[tone]) * (rng.uniform(0.88, 1.08) + rng.normal(0, 0.012, 3)), 0, 1)
    return Look(
        vertices=(points - depth[..., None] * radial).reshape(count, 3),
        faces=faces,
        normals=turned.reshape(count, 3),
        rgba=(float(colour[0]), float(colour[1]), float(colour[2]), 1.0),
        texcoords=_flat_coordinates(points, normals, rng.uniform(0, 2 * np.pi)).reshape(count, 2),
        texture=_grain(int(rng.integers(_GRAINS))),
        specular=0.05,
        shininess=0.1,
    )


def _flat_coordinates(points: np.ndarray, normals: np.ndarray, angle: float) -> Float[np.ndarray, "T P 2"]:
    """Texture coordinates of points along two axes of their facet, both turned by ``angle``."""
    x, y, z = normals.T
    none = np.zeros_like(x)
    across = np.where(np.abs(z[:, None]) < 0.9, np.column_stack([-y, x, none]), np.column_stack([none, -z, y]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    turned = np.stack(
        [np.cos(angle) * across - np.sin(angle) * along, np.sin(angle) * across + np.cos(angle) * along], axis=1
    )
    return 0.5 + np.einsum("tpx,tix->tpi", points, turned) / _TEXTURE_SPAN


@lru_cache(maxsize=4)
def _broken_triangle(segments: int) -> tuple[Float[np.ndarray, "P 3"], np.ndarray]:
    """Barycentric grid points (P, 3) of a triangle and the small triangles between them (M, 3)."""
    index = {}
    for k in range(segments + 1):
        for j in range(segments + 1 - k):
            index[j, k] = len(index)
    grid = np.array([[segments - j - k, j, k] for j, k in index]) / segments
    small = []
    for j, k in index:
        if j + k < segments:
            small.append((index[j, k], index[j + 1, k], index[j, k + 1]))
        if j + k < segments - 1:
            small.append((index[j + 1, k], index[j + 1, k + 1], index[j, k + 1]))
    return grid, np.array(small)


@lru_cache(maxsize=_GRAINS)
def _grain(number: int) -> UInt8[np.ndarray, "H W 3"]:
    """A pale mineral texture with blotches, speckles and dark veins, to be multiplied by a colour."""
    rng = np.random.default_rng([number, 0x6EA1])
    blotches = cloud(rng, _TEXELS, 1.7)
    veins = np.abs(cloud(rng, _TEXELS, 1.9))
    value = 0.86 + 0.09 * blotches + rng.normal(0, 0.06, blotches.shape)
    value = value - 0.16 * np.exp(-((veins / 0.05) ** 2))
    tint = 0.02 * cloud(rng, _TEXELS, 1.6)
    picture = np.stack([value + tint, value, value - tint], axis=2)
    return np.clip(255 * picture, 0, 255).astype(np.uint8)


def cloud(rng: np.random.Generator, size: int, fall: float) -> Float[np.ndarray, "size size"]:
    """Seamless noise with amplitude ∝ frequency^−``fall``, mean 0 and standard deviation 1."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size) * size, np.fft.fftfreq(size) * size))
    frequency[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) / frequency**fall
    spectrum[0, 0] = 0.0
    noise = np.real(np.fft.ifft2(spectrum))
    return noise / noise.std()
