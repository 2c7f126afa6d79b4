"""Differentiable planning of pick-and-place with regrasp.

Importing the package switches JAX to 64-bit floats (support functions and their argmins need them) and, unless the
user has configured one, turns on JAX's persistent compilation cache in ``$REGRASP_CACHE_DIR`` (default
``~/.cache/regrasp-gym/jax``), so that a second process does not compile again.
"""

from __future__ import annotations

import os
from pathlib import Path

import jax


def _configure_jax() -> None:
    jax.config.update("jax_enable_x64", True)
    if jax.config.jax_compilation_cache_dir is None:
        folder = os.environ.get("REGRASP_CACHE_DIR") or Path.home() / ".cache" / "regrasp-gym" / "jax"
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


_configure_jax()

from regrasp_planner.errors import GeometryError, RegraspError, StrategyError, TaskError  # noqa: E402
from regrasp_planner.geometry import ConvexBody, certified_distance, separation, signed_distance  # noqa: E402
from regrasp_planner.grasp.grasp import Grasp, GraspGenOptions  # noqa: E402
from regrasp_planner.grasp.grasp_gen import generate_grasps  # noqa: E402
from regrasp_planner.path.trajectory import Trajectory  # noqa: E402
from regrasp_planner.placement.stab_pose import StablePoses, stable_poses  # noqa: E402
from regrasp_planner.robot.model import Arm, Gripper, Robot  # noqa: E402
from regrasp_planner.stages.options import PlanOptions  # noqa: E402
from regrasp_planner.stages.pipeline import plan  # noqa: E402
from regrasp_planner.stages.plan import (  # noqa: E402
    Failure,
    Phase,
    Plan,
    PlanStats,
    Reason,
    Segment,
    SegmentKind,
    Stage,
    StageKind,
    Strategy,
)
from regrasp_planner.task import Body, Obstacle, ReleaseArea, Scene, Task  # noqa: E402

__all__ = [
    "Arm",
    "Body",
    "ConvexBody",
    "Failure",
    "GeometryError",
    "Grasp",
    "GraspGenOptions",
    "Gripper",
    "Obstacle",
    "Phase",
    "Plan",
    "PlanOptions",
    "PlanStats",
    "Reason",
    "RegraspError",
    "ReleaseArea",
    "Robot",
    "Scene",
    "Segment",
    "SegmentKind",
    "StablePoses",
    "Stage",
    "StageKind",
    "Strategy",
    "StrategyError",
    "Task",
    "TaskError",
    "Trajectory",
    "certified_distance",
    "generate_grasps",
    "plan",
    "separation",
    "signed_distance",
    "stable_poses",
]
