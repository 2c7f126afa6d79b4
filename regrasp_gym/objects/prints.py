"""Printed labels and skins of the stand-ins, drawn in code. No brands: the words name the contents."""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import KDTree

Picture = UInt8[np.ndarray, "H W 3"]
Rgb = tuple[int, int, int]

TILE = 96
"""Edge of a texture tile, pixels: enough for camera images of 256 pixels, and quick to load."""


def panel(
    aspect: float,
    ground: Rgb,
    *,
    bands: tuple[tuple[float, float, Rgb], ...] = (),
    text: str = "",
    ink: Rgb = (255, 255, 255),
    at: float = 0.3,
    disc: tuple[float, float, Rgb] | None = None,
    lines: tuple[float, float, Rgb] | None = None,
    size: tuple[int, int] = (TILE, TILE),
) -> Picture:
    """One printed face.

    Args:
        aspect: width over height of the printed face.
        ground: background colour.
        bands: (top, bottom, colour) in shares of the height.
        text: words, one per line, as large as fits.
        ink: colour of the words.
        at: height of the middle of the words, as a share from the top.
        disc: (height of its middle, radius, colour) of a round picture, in shares of the height and the shorter side.
        lines: (top, bottom, colour) of small print.
        size: (width, height) in pixels.
    """
    height = 2 * TILE
    width = max(8, round(height * aspect))
    image = Image.new("RGB", (width, height), ground)
    draw = ImageDraw.Draw(image)
    for top, bottom, colour in bands:
        draw.rectangle([0, top * height, width, bottom * height], fill=colour)
    if disc is not None:
        middle, radius, colour = disc
        r = radius * min(width, height)
        draw.ellipse([width / 2 - r, middle * height - r, width / 2 + r, middle * height + r], fill=colour)
        draw.ellipse(
            [width / 2 - 0.7 * r, middle * height - 0.75 * r, width / 2 + 0.5 * r, middle * height + 0.45 * r],
            fill=tuple(min(255, c + 28) for c in colour),
        )
    if lines is not None:
        top, bottom, colour = lines
        for k in range(int((bottom - top) / 0.045)):
            y = top + 0.045 * k
            end = width * (0.88 if k % 3 else 0.66)
            draw.rectangle([0.12 * width, y * height, end, (y + 0.018) * height], fill=colour)
    rows = text.split()
    for k, row in enumerate(rows):
        font = ImageFont.load_default(size=_fitting(row, 0.84 * width, 0.8 * height / max(4, len(rows) + 1)))
        y = (at + 0.17 * (k - (len(rows) - 1) / 2)) * height
        draw.text((width / 2, y), row, fill=ink, font=font, anchor="mm")
    return np.asarray(image.resize(size, Image.Resampling.LANCZOS))


def atlas(front: Picture, side: Picture, top: Picture) -> Picture:
    """Texture of `regrasp_gym.rendering.surfaces.textured_box`: ``front`` on ±x, ``side`` on ±y, ``top`` on ±z."""
    row = np.concatenate([front, side, top], axis=1)
    return np.concatenate([row, row], axis=0)


def around(*faces: Picture) -> Picture:
    """Faces side by side, for a wall."""
    return np.concatenate(faces, axis=1)


def rubiks_cube() -> Picture:
    """Six faces of 3 × 3 stickers, shuffled the same way each time."""
    colours = np.array([[185, 20, 30], [10, 70, 170], [245, 245, 240], [240, 110, 20], [10, 140, 60], [250, 210, 30]])
    stickers = np.random.default_rng(77).permutation(np.repeat(np.arange(6), 9)).reshape(2, 3, 3, 3)
    picture = np.full((2 * TILE, 3 * TILE, 3), 18, np.uint8)
    edge, gap = TILE // 3, 3
    for (row, column, i, j), colour in np.ndenumerate(stickers):
        y, x = row * TILE + i * edge, column * TILE + j * edge
        picture[y + gap : y + edge - gap, x + gap : x + edge - gap] = colours[colour]
    return picture


def speckled(ground: Rgb, amount: float, seed: int, size: tuple[int, int] = (TILE, TILE)) -> Picture:
    """A plain skin with grain of standard deviation ``amount`` (in units of 255)."""
    grain = np.random.default_rng(seed).normal(0.0, 255 * amount, (size[1], size[0], 1))
    return np.clip(np.array(ground) + grain, 0, 255).astype(np.uint8)


def blended(top: Rgb, bottom: Rgb, blush: Rgb, seed: int, grain: float = 0.015) -> Picture:
    """A fruit's skin: two colours from pole to pole and a blush on one side."""
    v, u = np.meshgrid(np.linspace(0, 1, TILE), np.linspace(0, 1, 2 * TILE), indexing="ij")
    base = np.array(top) * (1 - v[..., None]) + np.array(bottom) * v[..., None]
    share = (0.75 * (0.5 + 0.5 * np.cos(2 * np.pi * (u - 0.35))) ** 1.5 * np.sin(np.pi * v) ** 0.5)[..., None]
    noise = np.random.default_rng(seed).normal(0.0, 255 * grain, (TILE, 2 * TILE, 1))
    return np.clip(base * (1 - share) + np.array(blush) * share + noise, 0, 255).astype(np.uint8)


def stitched(ground: Rgb, thread: Rgb, width: float, dashed: bool) -> Picture:
    """A ball with the closed seam of a baseball or tennis ball, as a latitude-longitude skin.

    Args:
        ground, thread: colours.
        width: angular width of the seam, radians.
        dashed: whether the seam consists of stitches.
    """
    t = np.linspace(0, 2 * np.pi, 145)[:-1]
    a, b = 0.75, 0.25
    seam = np.column_stack(
        [
            a * np.cos(t) + b * np.cos(3 * t),
            a * np.sin(t) - b * np.sin(3 * t),
            2 * np.sqrt(a * b) * np.sin(2 * t),
        ]
    )
    chord, nearest = KDTree(seam).query(_directions())
    on_seam = chord < 2 * np.sin(width / 2)
    if dashed:
        on_seam &= nearest % 3 != 0
    skin = np.where(on_seam[:, None], np.array(thread), np.array(ground))
    return skin.reshape(TILE, 2 * TILE, 3).astype(np.uint8)


def dotted(ground: Rgb, dot: Rgb, count: int, width: float) -> Picture:
    """A latitude-longitude skin with ``count`` evenly spread dots of angular radius ``width`` (dimples, seeds)."""
    k = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    middle = np.column_stack([np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)])
    near = KDTree(middle).query(_directions())[0] < 2 * np.sin(width / 2)
    skin = np.where(near[:, None], np.array(dot), np.array(ground))
    return skin.reshape(TILE, 2 * TILE, 3).astype(np.uint8)


@cache
def _directions() -> Float[np.ndarray, "N 3"]:
    """Unit directions of the texels of a latitude-longitude skin, row by row from the upper pole."""
    polar, azimuth = np.meshgrid(
        np.pi * (np.arange(TILE) + 0.5) / TILE, np.pi * (np.arange(2 * TILE) + 0.5) / TILE, indexing="ij"
    )
    polar, azimuth = polar.ravel(), azimuth.ravel()
    return np.column_stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


def _fitting(row: str, width: float, height: float) -> float:
    """Font size at which ``row`` fills the width without exceeding the height."""
    reference = ImageFont.load_default(size=32).getlength(row)
    return max(6.0, min(32 * width / reference, height))
