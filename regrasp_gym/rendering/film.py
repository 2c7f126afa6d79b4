"""Films of pictures, as MP4 files."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from jaxtyping import UInt8


def write_film(path: Path, pictures: Iterable[UInt8[np.ndarray, "H W 3"]], fps: int) -> None:
    """Write pictures as an H.264 film, whole or not at all.

    The film grows beside ``path`` and is renamed at the end, so an error midway keeps an older film.

    Args:
        path: .mp4 file to write; its folder is made.
        pictures: at least one, all of one size, encoded one by one.
        fps: pictures per second.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.stem}.unfinished{path.suffix}")
    try:
        # H.264 stores colour for blocks of 2×2 pixels: odd sizes are scaled to even ones.
        writer = imageio.get_writer(unfinished, fps=fps, codec="libx264", macro_block_size=2)
        # As a context manager a writer stays open after an error.
        with closing(writer):
            for picture in pictures:
                writer.append_data(picture)  # type: ignore[attr-defined]
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
