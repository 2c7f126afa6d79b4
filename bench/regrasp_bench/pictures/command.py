"""``regrasp-bench pictures``: make the pictures of README and docs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro
from rich.console import Console

from regrasp_gym.errors import OptionError
from regrasp_gym.reports.files import write_text

Name = Literal["union", "basins", "poses", "execution", "architecture"]


@dataclass(frozen=True)
class PicturesOptions:
    """Draw the pictures that explain the method, as PNG files; execution as JPEG, architecture as SVG.

    union: pick and place scene, and both about the target with the grasps found. basins: start directions by the pose
    into which they settle, and the cones inscribed in these basins. poses: stable poses of several objects with their
    cones. execution: one regrasp, frame by frame. architecture: the wings of each package and the imports between them.
    """

    names: Annotated[tuple[Name, ...], tyro.conf.Positional] = get_args(Name)
    """Pictures to draw; by default all."""
    folder: Path = Path("docs/figures")
    """Folder of the files."""
    env: str = "regrasp_gym/PandaYCB-v0"
    """Environment id of the scenes."""
    union_seed: int | None = None
    """Seed of the scene of union; by default the first in which one grasp suffices although the target lies on its
    side."""
    execution_seed: int | None = None
    """Seed of the scene of execution; by default the first in which the target is released tilted. The search for it
    may take minutes."""
    thing: str = "stone"
    """Object of basins: a shipped one, or "stone"."""


def pictures(options: PicturesOptions) -> int:
    """Draw the pictures; returns the exit code.

    Raises:
        OptionError: there is no such object.
        EnvError: no scene is fit for a picture.
    """
    thing, env = options.thing, options.env
    # These load JAX, which --help need not.
    from regrasp_bench.pictures import studio
    from regrasp_bench.pictures.architecture import architecture_svg
    from regrasp_bench.pictures.basins import STONE, basins_picture
    from regrasp_bench.pictures.execution import execution_picture
    from regrasp_bench.pictures.poses import poses_picture
    from regrasp_bench.pictures.union import union_picture
    from regrasp_gym.objects import OBJECTS

    if thing != STONE and thing not in OBJECTS:
        raise OptionError(f"unknown object {thing!r}; give {STONE!r} or one of {', '.join(OBJECTS)}")
    draw: dict[Name, Callable[[], studio.Picture | str]] = {
        "union": lambda: union_picture(env, options.union_seed),
        "basins": lambda: basins_picture(thing),
        "poses": poses_picture,
        "execution": lambda: execution_picture(env, options.execution_seed),
        "architecture": architecture_svg,
    }
    suffixes = {"execution": ".jpg", "architecture": ".svg"}
    console = Console()
    for name in options.names:
        with console.status(f"drawing {name}"):
            file = (options.folder / name).with_suffix(suffixes.get(name, ".png"))
            drawn = draw[name]()
            if isinstance(drawn, str):
                write_text(file, drawn)
            else:
                studio.save(drawn, file)
        console.print(f"Wrote {file} ({file.stat().st_size // 1000} kB)", markup=False, highlight=False)
    return 0
