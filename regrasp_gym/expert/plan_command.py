"""``regrasp-plan``: plan one scene, print the stages or why there is no plan, and show it."""

from __future__ import annotations

import gc
import sys
from dataclasses import asdict, dataclass
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import regrasp_gym
from regrasp_gym.errors import OptionError
from regrasp_gym.reports.command_line import JsonFile, run_command
from regrasp_gym.reports.files import write_json

if TYPE_CHECKING:
    from regrasp_gym.scenes.scene import Pose
    from regrasp_planner import Gripper, Plan, Stage


@dataclass(frozen=True)
class PlanCommandOptions:
    """Plan one scene, print the stages or why there is no plan, and show it.

    Exits with 0 if there is a plan (and, for a film, its execution succeeds), with 1 if there is none, with 2 on a
    wrong argument.
    """

    env: str = "regrasp_gym/PandaYCB-v0"
    """Id of the environment."""
    seed: int = 0
    """Seed of the scene."""
    strategy: str = "repeated"
    """What the planner may use: direct (one grasp), static (a regrasp in a stable pose), nonstatic (a regrasp with a
    tilted release), repeated (as many regrasps as needed), or sampling (the baseline)."""
    planner_seed: int = 0
    """Seed of the planner."""
    render: Path | None = None
    """A picture of the plan (.png) or a film of its execution in the simulation (.mp4)."""
    json_file: JsonFile = None
    """Write the result as JSON."""


def main() -> None:
    """Entry point."""
    options = tyro.cli(PlanCommandOptions, prog="regrasp-plan", description=PlanCommandOptions.__doc__)
    # The process ends after one plan: the collector would only walk over what JAX's tracing keeps.
    gc.disable()
    sys.exit(run_command("regrasp-plan", lambda: run(options)))


def run(options: PlanCommandOptions) -> int:
    """Plan the scene; returns the exit code.

    Raises:
        OptionError: ``render`` is neither a picture nor a film.
    """
    suffix = options.render.suffix if options.render else ""
    if suffix not in ("", ".png", ".mp4"):
        raise OptionError(f"--render {options.render}: give a file that ends in .png or .mp4")
    # Imported after the check because it loads JAX.
    from regrasp_gym.expert.plan_picture import save_execution, save_plan_picture

    env = gymnasium.make(options.env, render_mode="rgb_array" if suffix else None)
    try:
        _, info = env.reset(seed=options.seed)
        expert = regrasp_gym.PlannerExpert(env, options.strategy, options.planner_seed)
        expert.reset()
        plan = expert.plan
        console = Console()
        console.print(f"{options.env}, seed {options.seed}: {info['instruction']}", highlight=False)
        report: dict[str, Any] = {"env": options.env, "seed": options.seed, **describe(plan)}
        if plan.failure is not None:
            console.print(f"No plan: {plan.failure}", markup=False, highlight=False)
        else:
            console.print(_table(plan, expert.env.planner_robot.gripper))
        seconds = ", ".join(f"{name} {1e3 * value:.0f} ms" for name, value in plan.stats.seconds.items())
        console.print(f"{seconds}; {plan.stats.eval_grasp_calls} evaluated grasps", highlight=False)
        done = plan.success
        if plan.success and suffix == ".png" and options.render:
            save_plan_picture(expert.env, plan, options.render)
        if plan.success and suffix == ".mp4" and options.render:
            done = save_execution(expert.env, expert, options.render)
            report["executed"] = done
            console.print(f"Executed: {'success' if done else expert.failure}", markup=False, highlight=False)
        if plan.success and options.render:
            console.print(f"Wrote {options.render}", markup=False, highlight=False)
        if options.json_file:
            write_json(options.json_file, report)
        return 0 if done else 1
    finally:
        env.close()


def describe(plan: Plan) -> dict[str, Any]:
    """A plan as JSON can hold it, without the paths."""
    return {
        "success": plan.success,
        "failure": asdict(plan.failure) if plan.failure else None,
        "strategy": str(plan.strategy),
        "planner_seed": plan.seed,
        "eval_grasp_calls": plan.stats.eval_grasp_calls,
        "seconds": plan.stats.seconds,
        "stages": [
            {
                "kind": str(stage.kind),
                "grasp_pose": [float(v) for v in stage.grasp.pose],
                "theta": stage.grasp.theta,
                "quality": stage.grasp.quality,
                "start_pose": [float(v) for v in stage.start_pose],
                "release_pose": [float(v) for v in stage.release_pose],
                "settled_pose": [float(v) for v in stage.settled_pose],
                "duration": _duration(stage),
            }
            for stage in plan.stages
        ],
    }


def _duration(stage: Stage) -> float:
    return sum(segment.trajectory.duration for segment in stage.segments if segment.trajectory is not None)


def _table(plan: Plan, gripper: Gripper) -> Table:
    from regrasp_gym.expert.plan_picture import release_tilt
    from regrasp_planner.robot.gripper import pad_gap

    # Narrow enough for a terminal of 80 columns.
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("stage", no_wrap=True)
    table.add_column("let go at\n(m)", no_wrap=True)
    for name in ("tilt\n(°)", "width\n(mm)", "grasp\nquality", "gap\n(mm)", "time\n(s)"):
        table.add_column(name, justify="right")
    for stage in plan.stages:
        table.add_row(
            str(stage.kind),
            _position(stage.release_pose),
            f"{degrees(release_tilt(stage)):.0f}",
            f"{1e3 * pad_gap(gripper, stage.grasp.theta):.1f}",
            f"{stage.grasp.quality:.3f}",
            f"{1e3 * stage.grasp.clearance:.1f}",
            f"{_duration(stage):.1f}",
        )
    return table


def _position(pose: Pose) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*pose[4:])
