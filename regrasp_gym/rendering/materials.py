"""Materials of fixtures and their textures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8


@dataclass(frozen=True)
class Material:
    """The look of a fixture.

    Attributes:
        texture: function that draws the (H, W, 3) picture; None for an even surface.
        repeat: repetitions of the texture per metre.
        rgba: colour, multiplied with the texture.
        specular, shininess: in [0, 1].
    """

    texture: Callable[[np.random.Generator], UInt8[np.ndarray, "H W 3"]] | None = None
    repeat: float = 1.0
    rgba: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    specular: float = 0.1
    shininess: float = 0.2


def wood(
    rng: np.random.Generator, light: tuple[int, int, int], dark: tuple[int, int, int], size: int = 256
) -> UInt8[np.ndarray, "H W 3"]:
    """Planks along the texture's width, with grain, seamless in both directions."""
    v, u = np.meshgrid(*[np.arange(size) / size] * 2, indexing="ij")
    planks = 4
    plank = np.floor(v * planks).astype(int)
    shade = rng.uniform(-0.12, 0.12, planks)[plank]
    shift = rng.uniform(0, 1, planks)[plank]
    wave = 0.25 * np.sin(2 * np.pi * (u + shift)) + 0.1 * np.sin(2 * np.pi * (3 * u + 2 * shift))
    grain = 0.5 + 0.5 * np.sin(2 * np.pi * (7 * planks * v + wave + 5 * shift))
    fibre = rng.normal(size=(size, size))
    spectrum = np.fft.fft2(fibre) * np.exp(-((np.fft.fftfreq(size) * 60) ** 2))
    fibre = np.real(np.fft.ifft2(spectrum))
    fibre /= np.abs(fibre).max()
    mix = np.clip(0.25 + 0.3 * grain + 0.25 * fibre + shade, 0, 1)[..., None]
    picture = (1 - mix) * np.array(light) + mix * np.array(dark)
    seam = ((v * planks) % 1 < 0.02)[..., None]
    return np.where(seam, picture * 0.82, picture).astype(np.uint8)


def speckled(
    rng: np.random.Generator, colour: tuple[int, int, int], strength: float = 6.0, size: int = 128
) -> UInt8[np.ndarray, "H W 3"]:
    """An even colour with a little noise."""
    noise = rng.normal(0, strength, (size, size, 1))
    return np.clip(np.array(colour) + noise, 0, 255).astype(np.uint8)


def ground(
    rng: np.random.Generator,
    colour: tuple[int, int, int],
    clods: float,
    pebbles: int,
    size: int = 256,
) -> UInt8[np.ndarray, "H W 3"]:
    """Seamless soil or gravel of patches, clods and pebbles, each pebble lit from one side.

    Args:
        rng: random numbers of the texture.
        colour: colour of the soil.
        clods: contrast of patches and clods, of 255.
        pebbles: number of pebbles.
        size: edge length, pixels.
    """
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(size) * size] * 2))
    frequency[0, 0] = np.inf
    noise = np.real(np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) / frequency**1.1))
    grain = rng.normal(0, 0.35, (size, size))
    shade = clods * (noise / noise.std() + grain)
    v, u = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    for _ in range(pebbles):
        middle, radius = rng.uniform(0, size, 2), size * rng.uniform(0.004, 0.012)
        tone, squeeze, angle = rng.normal(3, 10), rng.uniform(0.6, 1.0), rng.uniform(0, np.pi)
        extent = int(radius / squeeze) + 2
        # A pebble across one edge continues at the opposite edge.
        rows = (np.arange(int(middle[0]) - extent, int(middle[0]) + extent + 1)) % size
        columns = (np.arange(int(middle[1]) - extent, int(middle[1]) + extent + 1)) % size
        window = np.ix_(rows, columns)
        y = (v[window] - middle[0] + size / 2) % size - size / 2
        x = (u[window] - middle[1] + size / 2) % size - size / 2
        along, across = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
        inside = along**2 * squeeze + across**2 / squeeze < radius**2
        shade[window] = np.where(inside, tone - 9 * (x + y) / radius, shade[window])
    return np.clip(np.array(colour) + shade[..., None], 0, 255).astype(np.uint8)


MATERIALS: dict[str, Material] = {
    "table": Material(lambda rng: wood(rng, (214, 178, 132), (166, 122, 78)), 2.0),
    "shelf": Material(lambda rng: wood(rng, (242, 236, 226), (214, 203, 186)), 3.0),
    "floor": Material(lambda rng: speckled(rng, (150, 156, 164)), 1.0),
    "acrylic": Material(rgba=(0.8, 0.9, 0.95, 0.22), specular=0.6, shininess=0.8),
    "earth": Material(lambda rng: ground(rng, (128, 113, 94), 9.0, 260), 0.5, specular=0.0, shininess=0.0),
    "gravel": Material(lambda rng: ground(rng, (150, 146, 138), 6.0, 1500), 0.4, specular=0.0, shininess=0.0),
    "plain": Material(lambda rng: ground(rng, (150, 148, 128), 4.0, 0), 0.06, specular=0.0, shininess=0.0),
}
"""Materials of fixtures by name."""
