"""Parts of networks: scaled and relative features of a goal environment's observation, and a normalising activation."""

from __future__ import annotations

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from regrasp_gym.envs.observation import state_layout

_NEAR = 10.0
"""Factor of distances in metres: 10 cm become 1."""

_FACTORS = {"joint velocities": 0.3, "finger coordinate": 25.0, "finger rate": 5.0, "target half extents": 10.0}
"""Factors of parts of `observation`; the others are near 1 already."""


class GoalFeatures(BaseFeaturesExtractor):
    """Scaled observation, target relative to the gripper, goal relative to the target, and both goals.

    The scales are constants, so a checkpoint needs no statistics.

    Args:
        observation_space: of an environment of this project with ``obs_type="state"``.
        joints: number of joints of the arm.
    """

    def __init__(self, observation_space: spaces.Dict, joints: int) -> None:
        shapes = {key: space.shape for key, space in observation_space.spaces.items()}
        size, goal = (int(np.prod(shapes[key] or (0,))) for key in ("observation", "achieved_goal"))
        super().__init__(observation_space, size + 2 * goal + 6)
        scale: list[float] = []
        starts: dict[str, int] = {}
        for name, count in state_layout(joints, 0):
            starts[name] = len(scale)
            scale += [_FACTORS.get(name, 1.0)] * count
        scale += [1.0] * (size - len(scale))
        self.scale: torch.Tensor
        self.register_buffer("scale", torch.tensor(scale))
        self.gripper = starts["gripper pose"] + 4

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """(batch, features) of a batch of observations."""
        seen, achieved, desired = (observations[key] for key in ("observation", "achieved_goal", "desired_goal"))
        target = achieved[:, 4:7]
        to_target = _NEAR * (target - seen[:, self.gripper : self.gripper + 3])
        to_goal = _NEAR * (desired[:, 4:7] - target)
        return torch.cat([self.scale * seen, achieved, desired, to_target, to_goal], dim=1)


class NormalizedReLU(torch.nn.Module):
    """ReLU of the layer's outputs normalised to mean 0 and variance 1.

    Keeps critics from overestimating actions unlike any demonstration (Ball et al.,
    "Efficient online reinforcement learning with offline data", ICML 2023, §4.2).
    """

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(batch, features) of (batch, features)."""
        return torch.relu(torch.nn.functional.layer_norm(inputs, inputs.shape[-1:]))
