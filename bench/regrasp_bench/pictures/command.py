"""``regrasp-bench pictures``: the pictures of README and docs, made anew."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro
from rich.console import Console

from regrasp_gym.errors import OptionError

Name = Literal["union", "basins", "poses", "execution"]


def pictures(
    names: Annotated[tuple[Name, ...], tyro.conf.Positional] = get_args(Name),
    folder: Path = Path("docs/figures"),
    env: str = "regrasp_gym/PandaYCB-v0",
    union_seed: int | None = None,
    execution_seed: int | None = None,
    thing: str = "stone",
) -> None:
    """Draw the pictures that explain the method, as PNG files; execution as JPEG.

    union: pick and place scene, and both about the target with the grasps found. basins: start directions by the pose
    they settle into, and the cones inscribed in these basins. poses: stable poses of several objects with their cones.
    execution: one regrasp, frame by frame.

    Args:
        names: which; all by default.
        folder: where the files go.
        env: id of the environment whose scenes are drawn.
        union_seed: seed of the scene of union; by default the first one in which one grasp suffices although the
            target lies on its side.
        execution_seed: seed of the scene of execution; by default the first one in which the target is let go tilted.
            Looking for that may take minutes.
        thing: object of basins: a shipped one, or "stone".
    """
    # After the arguments are known to be right: these load JAX.
    from regrasp_bench.pictures import studio
    from regrasp_bench.pictures.basins import STONE, basins_picture
    from regrasp_bench.pictures.execution import execution_picture
    from regrasp_bench.pictures.poses import poses_picture
    from regrasp_bench.pictures.union import union_picture
    from regrasp_gym.objects import OBJECTS

    if thing != STONE and thing not in OBJECTS:
        raise OptionError(f"unknown object {thing!r}; give {STONE!r} or one of {', '.join(OBJECTS)}")
    draw: dict[str, Callable[[], studio.Picture]] = {
        "union": lambda: union_picture(env, union_seed),
        "basins": lambda: basins_picture(thing),
        "poses": poses_picture,
        "execution": lambda: execution_picture(env, execution_seed),
    }
    console = Console()
    for name in names:
        with console.status(f"drawing {name}"):
            file = folder / (f"{name}.jpg" if name == "execution" else f"{name}.png")
            studio.save(draw[name](), file)
        console.print(f"Wrote {file} ({file.stat().st_size // 1000} kB)", markup=False, highlight=False)
