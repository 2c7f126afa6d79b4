"""Scenes of the lifting task: one object on an empty table, to be held a little above its start.

A scene depends on a seed and a `LiftConfig` alone. The robot's base is the world's origin, the table top is z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_gym.checks import check_names, check_positive, check_seed
from regrasp_gym.errors import SceneError
from regrasp_gym.geometry.poses import about_z, to_pose
from regrasp_gym.objects.ycb import OBJECTS
from regrasp_gym.scenes.resting import resting_poses
from regrasp_gym.scenes.scene import PlacedObject, ReleasePatch, Scene, level_support


@dataclass(frozen=True)
class LiftConfig:
    """Parameters of the scenes. Lengths in metres, angles in radians.

    Attributes:
        targets: names of the objects that may be the target.
        center, size: centre and full size of the rectangle that the target's origin starts in.
        yaw: largest turn, to either side, of the target's narrow sides from facing left and right.
        height: how far the target has to be lifted.
        max_opening, opening_margin: opening of the gripper, and how much narrower a target must be as it lies.
        table_center, table_size: centre of the table top, and its length, width and thickness.
    """

    targets: tuple[str, ...] = ("061_foam_brick",)
    center: tuple[float, float] = (0.48, 0.0)
    size: tuple[float, float] = (0.12, 0.16)
    yaw: float = 0.4
    height: float = 0.1
    max_opening: float = 0.08
    opening_margin: float = 0.004
    table_center: tuple[float, float] = (0.32, 0.02)
    table_size: tuple[float, float, float] = (1.2, 1.5, 0.04)

    def __post_init__(self) -> None:
        check_names(self, "targets", known=OBJECTS)
        check_positive(self, "height")
        for name in self.targets:
            least = min(pose.level_width for pose in resting_poses(OBJECTS[name]))
            if least > self.max_opening - self.opening_margin:
                raise SceneError(
                    f"target {name!r} is at least {1e3 * least:.0f} mm wide in every resting pose; "
                    f"the gripper takes at most {1e3 * (self.max_opening - self.opening_margin):.0f} mm"
                )


@dataclass(frozen=True, eq=False, kw_only=True)
class LiftScene(Scene):
    """A scene of the lifting task.

    The target has to be held at ``goal_pose``. ``release`` is the area it starts in: nothing is put down in this task.
    """

    config: LiftConfig

    @property
    def others(self) -> tuple[PlacedObject, ...]:
        """Always empty."""
        return ()

    @property
    def instruction(self) -> str:
        """The task in words."""
        return f"lift the {self.target.model.label} by {100 * self.config.height:.0f} cm"


def make_scene(seed: int, config: LiftConfig | None = None) -> LiftScene:
    """The scene of a seed.

    The target lies in the likeliest resting pose that the gripper fits over, at a random position. Its narrow sides
    face left and right, up to a random turn of ``config.yaw`` to either side.

    Args:
        seed: a non-negative integer.
        config: the default if None.

    Raises:
        SceneError: negative seed.
    """
    config = config or LiftConfig()
    check_seed(seed, "scene")
    rng = np.random.default_rng([seed, 0x11F7])
    model = OBJECTS[str(rng.choice(config.targets))]
    limit = config.max_opening - config.opening_margin
    resting = next(pose for pose in resting_poses(model) if pose.level_width <= limit)
    across = resting.level_axis
    yaw = _nearest_half_turn(np.pi / 2 - np.arctan2(across[1], across[0])) + rng.uniform(-config.yaw, config.yaw)
    rotation = Rotation.from_matrix(about_z(yaw) @ resting.rotation)
    half = np.array(config.size) / 2
    middle = np.array(config.center) + rng.uniform(-half, half)
    start = to_pose(rotation.as_quat(scalar_first=True), [*middle, resting.height])
    return LiftScene(
        seed=int(seed),
        config=config,
        target=PlacedObject(model, start),
        goal_pose=start + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, config.height]),
        fixtures=(level_support("table", config.table_size, config.table_center, "table"),),
        release=ReleasePatch(np.array([*config.center, 0.0]), half),
    )


def _nearest_half_turn(angle: float) -> float:
    """The angle modulo π, in [−π/2, π/2)."""
    return float((angle + np.pi / 2) % np.pi - np.pi / 2)
