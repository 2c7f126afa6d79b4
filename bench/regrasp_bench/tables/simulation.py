"""Times to make a scene, reset, step and draw, and how still a scene lies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from regrasp_bench.options import SceneOptions
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.summary import median_and_p90, milliseconds
from regrasp_bench.tables.timing import mean_seconds
from regrasp_gym.rendering.renderer import SceneRenderer
from regrasp_gym.reports.report import Record
from regrasp_gym.reports.trials import crashes, print_crashes
from regrasp_gym.simulation.world import World

OBSERVED = 128
"""Edge of an observed picture, pixels."""

STEPS = 50
"""Random actions in each scene."""

STILL = 3.0
"""How long the robot stands still, seconds."""


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(SceneOptions):
    """Time making a scene, resetting into it, steps at rest and under random actions, and drawing it.

    Also measure how far any object moves while the robot stands still.
    """

    scenes: int = 100
    """Number of scenes."""
    records: Path = Path("outputs/bench/simulation.jsonl")


def simulation(options: SimulationOptions) -> int:
    """Run the benchmark; returns the exit code."""
    setting: Record = {"env": options.env, "steps": STEPS, "still": STILL, "version": version("regrasp-gym")}
    presentation = Presentation(_show, packages=("regrasp-gym", "mujoco", "numpy"))
    return run_benchmark(options, setting, options.seeds, _prepare, summarise, presentation)


def summarise(setting: Record, scenes: Sequence[Record]) -> Record:
    """Median and 90 % quantile of the times of each call, and the largest drift."""
    timed = [scene["seconds"] for scene in scenes if "seconds" in scene]
    figures = {name: median_and_p90([seconds[name] for seconds in timed]) for name in (timed[0] if timed else ())}
    drift = max((scene["drift"] for scene in scenes if "drift" in scene), default=0.0)
    return {**setting, "scenes": len(timed), "seconds": figures, "drift_max": drift, "crashed": crashes(scenes)}


def _positions(world: World) -> Float[np.ndarray, "K 3"]:
    return np.vstack([world.target_pose, world.other_poses])[:, 4:]


def _prepare(setting: Record) -> Callable[[int], Record]:
    made: Any = gymnasium.make(setting["env"], render_mode="rgb_array", max_episode_steps=10**6)
    scenario, config = made.unwrapped.scenario, made.unwrapped.scene_config
    renderer = SceneRenderer(OBSERVED, OBSERVED)

    def observe() -> None:
        world = made.unwrapped.world
        renderer.render(world.model, world.data, scenario.pixels[0], OBSERVED, OBSERVED)

    made.reset(seed=0)
    made.render()
    observe()

    def run(seed: int) -> Record:
        made.action_space.seed(seed)
        scenario.make_scene(seed, config)  # caches its objects
        seconds = {"scene": mean_seconds(lambda: scenario.make_scene(seed, config))}
        seconds["reset, scene included"] = mean_seconds(lambda: made.reset(seed=seed))
        seconds["first frame of a scene"] = mean_seconds(made.render)
        seconds["frame, 640 × 480"] = mean_seconds(made.render)
        observe()
        seconds[f"observed picture, {OBSERVED} × {OBSERVED}"] = mean_seconds(observe, 5)
        at_rest = made.unwrapped.action_toward(made.unwrapped.command)
        start = _positions(made.unwrapped.world)
        steps = round(STILL / scenario.control_period)
        seconds["step at rest"] = mean_seconds(lambda: made.step(at_rest), steps)
        drift = float(np.linalg.norm(_positions(made.unwrapped.world) - start, axis=1).max())
        seconds["step, random action"] = mean_seconds(lambda: made.step(made.action_space.sample()), STEPS)
        return {"seconds": seconds, "drift": drift}

    return run


def _show(report: Record) -> None:
    table = Table("call", "ms", "p90", title=f"{report['env']}, {report['scenes']} scenes")
    for name, row in report["seconds"].items():
        table.add_row(name, milliseconds(row["median"], 2), milliseconds(row["p90"], 2))
    console = Console()
    console.print(table)
    drift = 1e3 * report["drift_max"]
    console.print(f"farthest that an object moves in {STILL:g} s at rest: {drift:.3f} mm", highlight=False)
    print_crashes(report["crashed"])
