"""The easiest of the Panda's tasks: one object on an empty table, to be lifted."""

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
"""The Panda on its table, with a single object."""


class PandaYCBLiftEnv(RegraspEnv):
    """Take the one object that lies on a table and hold it 10 cm higher.

    **Task.** A Franka Panda with a parallel gripper stands on a table on which the target lies, in reach and in a pose
    in which the gripper fits over it from above. The first step towards `PandaYCBEnv`: same robot, same actions, same
    layout of observations without other objects.

    **Randomizations.** From the scene's seed: which of the config's objects is the target (by default it is always the
    foam brick), where it lies in a rectangle of 12 × 16 cm in front of the robot, and how it is turned (±23° from where
    its narrow sides face left and right). It lies as it is most likely to land. `LiftConfig` holds the ranges. The
    robot always starts in its ready configuration with the gripper open.

    **Success.** The target is within 25 mm and 30° of the goal pose and *held still*: the gripper touches it, nothing
    else does, and it moves no faster than 50 mm/s and 0.5 rad/s. ``info["is_success"]`` says so for the present step;
    it can turn false again.

    **Goal.** The pose in which the target starts, 10 cm higher.

    ## Action Space

    As in `PandaYCBEnv`: ``control_mode="joint_pos"`` is `Box((8,), float32)` of joint positions (rad) and finger travel
    (m), ``control_mode="ee_delta"`` is `Box(-1, 1, (7,), float32)` of a move (±20 mm), a turn (±0.1 rad) and the finger
    travel. One step is 50 ms (20 Hz).

    ## Observation Space

    As in `PandaYCBEnv`, without other objects. ``obs_type="state"``: ``observation`` (32,), ``achieved_goal`` (10,) and
    ``desired_goal`` (10,).

    | Num    | observation                                             | Unit       |
    |--------|---------------------------------------------------------|------------|
    | 0–6    | joint positions                                         | rad        |
    | 7–13   | joint velocities                                        | rad/s      |
    | 14     | finger coordinate: travel of each finger                | m          |
    | 15     | finger rate                                             | m/s        |
    | 16–22  | gripper pose                                            | –, m       |
    | 23–28  | target velocity: linear, angular, world                 | m/s, rad/s |
    | 29–31  | target half extents along its axes                      | m          |

    | Num | achieved_goal, desired_goal                                                          | Unit |
    |-----|--------------------------------------------------------------------------------------|------|
    | 0–6 | pose of the target                                                                   | –, m |
    | 7   | 0 if it is held still (see Success), else 1; desired: 0                              | –    |
    | 8   | 1 if the gripper touches it, else 0; desired: 1                                      | –    |
    | 9   | distance of the gripper frame from the target's centre; desired: 0, never compared   | m    |

    ``obs_type="pixels_agent_pos"``: ``pixels`` (``front`` and ``wrist``, each (128, 128, 3) uint8), ``agent_pos`` (8,)
    and ``environment_state`` (17,): target pose 7, target half extents 3, goal pose 7.

    ## Rewards

    As in `PandaYCBEnv`: *sparse* is 0 on success and else -1, *dense* is 0 on success and else
    -1 + 0.25 reach + 0.7 closeness. ``compute_reward`` gives the same for any two goals, single or in batches, without
    using ``info``: success is a pose within tolerance and entries 7 and 8 of the achieved goal not above those of the
    desired one. A relabelled goal in which the target lies on the table is thus reached by having it there.

    ## Starting State

    The scene of the reset's seed, everything at rest; otherwise as in `PandaYCBEnv`.

    ## Episode End

    Termination: none by default; with ``terminate_on_success=True``, on success. Truncation: after 150 steps (7.5 s).

    ## Arguments

    As in `PandaYCBEnv`, with a `LiftConfig` for ``scene_config``.

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
