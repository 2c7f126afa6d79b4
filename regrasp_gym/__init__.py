"""Gymnasium environments for pick-and-place with regrasp.

Importing the package registers the environments. On Linux without a display it also chooses MuJoCo's off-screen
backend, unless ``MUJOCO_GL`` is set; this needs an import before MuJoCo's.
"""

from __future__ import annotations

import ctypes.util
import os
import sys
from typing import TYPE_CHECKING

import gymnasium
from gymnasium.envs.registration import WrapperSpec

if TYPE_CHECKING:
    from regrasp_gym.expert.expert import PlannerExpert

__all__ = ["PlannerExpert"]


def _choose_renderer() -> None:
    if sys.platform != "linux" or "MUJOCO_GL" in os.environ:
        return
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return
    has_only_osmesa = ctypes.util.find_library("OSMesa") and not ctypes.util.find_library("EGL")
    os.environ["MUJOCO_GL"] = "osmesa" if has_only_osmesa else "egl"


def _register() -> None:
    entries = {
        "PandaYCB-v0": ("panda_ycb:PandaYCBEnv", 1000),
        "PandaYCBLift-v0": ("panda_lift:PandaYCBLiftEnv", 150),
        "PandaYCBDirect-v0": ("panda_certified:PandaYCBDirectEnv", 1000),
        "PandaYCBRegrasp-v0": ("panda_certified:PandaYCBRegraspEnv", 1000),
        "ExcavatorStones-v0": ("excavator_stones:ExcavatorStonesEnv", 2000),
    }
    for name, (entry_point, steps) in entries.items():
        gymnasium.register(
            id=f"regrasp_gym/{name}",
            entry_point=f"regrasp_gym.envs.{entry_point}",
            max_episode_steps=steps,
            additional_wrappers=(WrapperSpec("GoalReward", "regrasp_gym.envs.wrappers:GoalReward", {}),),
        )


def __getattr__(name: str) -> object:
    # Loaded on first use: the planner loads JAX, which stepping does not need.
    if name == "PlannerExpert":
        from regrasp_gym.expert.expert import PlannerExpert

        return PlannerExpert
    raise AttributeError(f"module 'regrasp_gym' has no attribute {name!r}")


_choose_renderer()
_register()
