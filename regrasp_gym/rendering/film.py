"""Films of pictures, as MP4 files."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
from jaxtyping import UInt8

from regrasp_gym.reports.files import replacing


def write_film(path: Path, pictures: Iterable[UInt8[np.ndarray, "H W 3"]], fps: int) -> None:
    """Write pictures as an H.264 film, whole or not at all.

    Args:
        path: .mp4 file to write; its folder is made. After an error an older film is unchanged.
        pictures: at least one, all of one size; each is encoded as it comes.
        fps: pictures per second.
    """
    with replacing(path) as unfinished:
        # H.264 stores colour for blocks of 2×2 pixels: odd sizes are scaled to even ones.
        writer = imageio.get_writer(unfinished, fps=fps, codec="libx264", macro_block_size=2)
        # As a context manager a writer stays open after an error.
        with closing(writer):
            for picture in pictures:
                writer.append_data(picture)  # type: ignore[attr-defined]
