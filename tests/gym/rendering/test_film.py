from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest

from regrasp_gym.rendering.film import write_film


def pictures(count: int) -> Iterator[np.ndarray]:
    for k in range(count):
        yield np.full((48, 64, 3), 40 * k, np.uint8)


def test_a_film_holds_every_picture_in_order(tmp_path: Path) -> None:
    film = tmp_path / "films" / "steps.mp4"
    write_film(film, pictures(5), fps=20)
    with imageio.get_reader(film) as reader:
        assert reader.get_meta_data()["fps"] == 20
        shades = [float(np.mean(picture)) for picture in reader]
    np.testing.assert_allclose(shades, [0, 40, 80, 120, 160], atol=4)


def test_an_error_leaves_the_film_that_was_there(tmp_path: Path) -> None:
    def broken() -> Iterator[np.ndarray]:
        yield from pictures(2)
        raise RuntimeError("the simulation broke")

    film = tmp_path / "steps.mp4"
    write_film(film, pictures(3), fps=20)
    whole = film.read_bytes()
    with pytest.raises(RuntimeError, match="broke"):
        write_film(film, broken(), fps=20)
    assert film.read_bytes() == whole
    assert list(tmp_path.iterdir()) == [film]
