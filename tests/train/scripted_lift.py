"""An expert for lifting that needs no planner: over the target, turn, down, close, up. Acts through gripper moves."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

LIFT = "regrasp_gym/PandaYCBLift-v0"


class ScriptedLift:
    """Proportional moves of the gripper; made and asked like the planner's expert."""

    def __init__(self, env, strategy: str = "repeated", seed: int = 0) -> None:
        self._env = env.unwrapped
        self.failure, self.plan, self.stage_index = None, None, 0

    def reset(self) -> bool:
        self.plan = SimpleNamespace(stages=[None])
        self._closing, self._above = 0, True
        self._goal = self._env.scene.goal_pose
        return True

    def act(self, obs=None):
        world = self._env.world
        if self._env.is_success:
            return None
        gripper, target = world.gripper_pose, world.target_pose
        turn = self._turn(gripper, target)
        offset = target[4:] - gripper[4:]
        if self._above:
            offset = offset + np.array([0.0, 0.0, 0.08])
            self._above = np.abs(offset).max() > 0.008 or abs(turn) > 0.05
        elif np.abs(offset).max() < 0.008:
            self._closing += 1
        fingers = 1.0
        if self._closing:
            fingers, self._closing = -1.0, self._closing + 1
            offset = np.zeros(3) if self._closing < 8 else self._goal[4:] - target[4:]
            turn = 0.0
        move = np.clip(offset / 0.02, -0.9, 0.9)
        return np.array([*move, 0.0, 0.0, np.clip(turn / 0.1, -1, 1), fingers], np.float32)

    def _turn(self, gripper, target):
        """Angle about z that brings the closing axis (the gripper's y) to the target's narrow side."""
        axes = Rotation.from_quat(target[:4], scalar_first=True).as_matrix()
        level = [k for k in range(3) if abs(axes[2, k]) < 0.5]
        narrow = axes[:, min(level, key=lambda k: self._env.world.object_sizes[0][k])]
        closing = Rotation.from_quat(gripper[:4], scalar_first=True).as_matrix()[:, 1]
        angle = np.arctan2(narrow[1], narrow[0]) - np.arctan2(closing[1], closing[0])
        return (angle + np.pi / 2) % np.pi - np.pi / 2


def collected(root, **options):
    """Collect lifts of the scripted expert."""
    from rich.console import Console

    from regrasp_datasets.collect import CollectOptions, collect

    chosen = CollectOptions(
        root=root, env=LIFT, control_mode="ee_delta", expert="scripted_lift:ScriptedLift", **{"images": False} | options
    )
    assert collect(chosen, Console(quiet=True)) == 0
    return root
