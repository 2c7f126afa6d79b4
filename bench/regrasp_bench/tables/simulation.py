"""What an environment takes to make a scene, reset, take a step and draw; and how still a scene lies."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
import tyro
from jaxtyping import Float
from rich.console import Console
from rich.table import Table

from regrasp_gym.rendering.renderer import SceneRenderer
from regrasp_gym.reports.trials import Record, crashes, run_trials, write_report
from regrasp_gym.simulation.world import World

OBSERVED = 128
"""Edge of an observed picture, pixels."""

STEPS = 50
"""Random actions in each scene."""

STILL = 3.0
"""How long the robot stands still, seconds."""


def simulation(
    env: str = "regrasp_gym/PandaYCB-v0",
    scenes: int = 100,
    first_seed: int = 0,
    workers: int = 1,
    records: Path = Path("outputs/bench/simulation.jsonl"),
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Time making a scene, resetting into it, steps at rest and under random actions, and drawing it.

    Also, how far the object that moves most gets from where it starts while the robot stands still.

    Args:
        env: id of the environment.
        scenes: how many.
        first_seed: seed of the first.
        workers: processes; with more than one the times are not to be trusted.
        records: one JSON line per scene, appended as they end.
        json_file: write the summary as JSON.
    """
    setting: Record = {"env": env, "steps": STEPS, "still": STILL, "version": version("regrasp-gym")}
    seeds = range(first_seed, first_seed + scenes)
    ended = run_trials(setting, seeds, _prepare, workers=workers, records=records, label="scenes")
    report = summarise(setting, ended)
    _show(report)
    write_report(json_file, report, ("regrasp-gym", "mujoco", "numpy"))


def summarise(setting: Record, scenes: list[Record]) -> Record:
    """Median and 90 % quantile of the seconds of each call."""
    timed = [scene["seconds"] for scene in scenes if "seconds" in scene]
    figures = {
        name: {"median": float(np.median(values)), "p90": float(np.quantile(values, 0.9))}
        for name in (timed[0] if timed else ())
        for values in [[seconds[name] for seconds in timed]]
    }
    drift = max((scene["drift"] for scene in scenes if "drift" in scene), default=0.0)
    return {**setting, "scenes": len(timed), "seconds": figures, "drift_max": drift, "crashed": crashes(scenes)}


def _places(world: World) -> Float[np.ndarray, "K 3"]:
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
        scenario.make_scene(seed, config)  # its objects are kept from now on
        seconds = {"scene": _seconds(lambda: scenario.make_scene(seed, config))}
        seconds["reset, scene included"] = _seconds(lambda: made.reset(seed=seed))
        seconds["first frame of a scene"] = _seconds(made.render)
        seconds["frame, 640 × 480"] = _seconds(made.render)
        observe()
        seconds[f"observed picture, {OBSERVED} × {OBSERVED}"] = _seconds(observe, 5)
        at_rest = made.unwrapped.action_toward(made.unwrapped.command)
        start = _places(made.unwrapped.world)
        steps = round(STILL / scenario.control_period)
        seconds["step at rest"] = _seconds(lambda: made.step(at_rest), steps)
        drift = float(np.linalg.norm(_places(made.unwrapped.world) - start, axis=1).max())
        seconds["step, random action"] = _seconds(lambda: made.step(made.action_space.sample()), STEPS)
        return {"seconds": seconds, "drift": drift}

    return run


def _seconds(call: Callable[[], object], times: int = 1) -> float:
    """Mean seconds of a call."""
    began = time.perf_counter()
    for _ in range(times):
        call()
    return (time.perf_counter() - began) / times


def _show(report: Record) -> None:
    table = Table("call", "ms", "p90", title=f"{report['env']}, {report['scenes']} scenes")
    for name, row in report["seconds"].items():
        table.add_row(name, f"{1e3 * row['median']:.2f}", f"{1e3 * row['p90']:.2f}")
    console = Console()
    console.print(table)
    drift = 1e3 * report["drift_max"]
    console.print(f"farthest that an object moves in {STILL:g} s at rest: {drift:.3f} mm", highlight=False)
    for error, seeds in report["crashed"].items():
        console.print(f"crashed: {error}, seeds {seeds}", style="red", markup=False, highlight=False)
