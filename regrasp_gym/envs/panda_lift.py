"""The Panda's easiest task: lift the only object on a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.envs.panda_ycb import PANDA_YCB
from regrasp_gym.scenes.lift import LiftConfig, make_scene
from regrasp_gym.simulation.scenario import Tolerance

if TYPE_CHECKING:
    from regrasp_planner import Grasp, Plan, PlanOptions, Strategy

PANDA_LIFT = replace(
    PANDA_YCB,
    make_scene=make_scene,
    tolerance=Tolerance(position=0.025, rotation=float(np.deg2rad(30)), speed=0.05, turn_rate=0.5),
    max_others=0,
    held=True,
)
"""The Panda at its table with a single object."""


class PandaYCBLiftEnv(RegraspEnv):
    """Grasp the only object on a table and hold it 10 cm higher.

    A first step towards `PandaYCBEnv`: same robot, same actions, same observations without other objects. What is not
    said here is in `RegraspEnv`.

    **Task.** A Franka Panda with a parallel gripper stands on a table. The target lies on it within reach, in a pose
    that the gripper fits over from above.

    **Randomizations.** From the scene's seed: the target among the config's objects (by default only the foam brick),
    its position in a rectangle of 12 × 16 cm in front of the robot, and its yaw (narrow sides within 23° of facing left
    and right). It lies in its likeliest resting pose. `LiftConfig` holds the ranges. The robot always starts in its
    ready configuration with the gripper open.

    **Success.** The target is within 25 mm and 30° of the goal pose and *held still*: the gripper touches it, nothing
    else does, and it moves no faster than 50 mm/s and 0.5 rad/s.

    **Goal.** The target's start pose, 10 cm higher.

    ## Action Space

    As in `PandaYCBEnv`: ``control_mode="joint_pos"`` is `Box((8,), float32)` of joint positions (rad) and finger travel
    (m); ``control_mode="ee_delta"`` is `Box(-1, 1, (7,), float32)` of a translation (±20 mm), a rotation (±0.1 rad) and
    the finger travel. One step is 50 ms (20 Hz).

    ## Observation Space

    As in `PandaYCBEnv`, without other objects.

    - ``obs_type="state"``: ``observation`` (32,): joint positions 7 (rad), joint velocities 7 (rad/s), finger
      coordinate 1 (m), finger rate 1 (m/s), gripper pose 7 (–, m), target velocity 6 (m/s, rad/s), target half
      extents 3 (m). ``achieved_goal`` (10,) and ``desired_goal`` (10,): entry 7 is 0 if the target is held still, else
      1; entry 8 of the desired goal is 1.
    - ``obs_type="pixels_agent_pos"``: ``pixels`` (``front`` and ``wrist``, each (128, 128, 3) uint8), ``agent_pos``
      (8,): joint positions 7 (rad), finger coordinate 1 (m); ``environment_state`` (17,): target pose 7 (–, m), target
      half extents 3 (m), goal pose 7 (–, m).

    ## Rewards

    As in `RegraspEnv`, with lever 0.1 m/rad and length 0.2 m. A relabelled goal in which the target lies on the table
    is reached by leaving it there.

    ## Starting State

    The scene of the reset's seed, a `LiftScene`, with everything at rest.

    ## Episode End

    Termination: none by default; on success with ``terminate_on_success=True``. Truncation: after 150 steps (7.5 s).

    ## Arguments

    Those of `RegraspEnv`. ``scene_config`` is a `LiftConfig`; cameras are ``"overview"``, ``"front"`` and ``"wrist"``.

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, scene_config: LiftConfig | None = None, **arguments: Any) -> None:
        super().__init__(PANDA_LIFT, scene_config=scene_config or LiftConfig(), **arguments)

    def _plan(self, strategy: Strategy, seed: int, options: PlanOptions, known_grasps: Sequence[Grasp]) -> Plan:
        """A grasp and a straight line up, whatever the strategy."""
        from regrasp_planner.stages.lift import plan_lift

        del strategy
        return plan_lift(self.task(), self.planner_robot, seed, options, known_grasps)
