"""Panda with YCB objects: from a cluttered table upright onto a shelf."""

from __future__ import annotations

from typing import Any

import numpy as np

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.rendering.setting import Camera
from regrasp_gym.robots.panda import PANDA
from regrasp_gym.scenes.table_shelf import make_scene
from regrasp_gym.scenes.table_shelf_config import TableShelfConfig
from regrasp_gym.simulation.scenario import Scenario, Tolerance

PANDA_YCB = Scenario(
    robot=PANDA,
    make_scene=make_scene,
    control_period=0.05,
    tolerance=Tolerance(position=0.025, rotation=float(np.deg2rad(15)), speed=0.01, turn_rate=0.2),
    arrival=0.004,
    pace=1.0,
    max_others=8,
    translation_step=0.02,
    rotation_step=0.1,
    cameras=(
        Camera("front", (0.55, -1.0, 0.85), (0.42, 0.04, 0.1), 46.0),
        Camera("overview", (0.95, -1.5, 1.1), (0.3, 0.02, 0.22), 42.0),
    ),
    pixels=("front", "wrist"),
    floor_height=-0.75,
)
"""The Panda at its table with the shelf beside it."""


class PandaYCBEnv(RegraspEnv):
    """Take an object from a cluttered table and stand it upright on a cluttered shelf.

    What is not said here is in `RegraspEnv`.

    **Task.** A Franka Panda with a parallel gripper stands on a table. The target lies in clutter to the robot's right
    and belongs on the shelf to its left. Often no single grasp fits both places. Then the target has to be put down on
    the free patch of table in between and grasped again another way.

    **Randomizations.** From the scene's seed: the target (boxes, cans and bottles of the YCB set); the 3–5 objects
    around it and the 2–3 objects on the shelf; the resting poses on the table; positions and yaws. Resting poses are
    drawn by the probability that a dropped object lands in them, the target's among those that the gripper fits over.
    `TableShelfConfig` holds the ranges. The robot always starts in its ready configuration with the gripper open.

    **Success.** The target is within 25 mm and 15° of the goal pose, moves no faster than 10 mm/s and 0.2 rad/s,
    something other than the gripper supports it, and the gripper does not touch it.

    **Goal.** A pose of the target: upright on the shelf's board, its narrow sides within 29° of left and right as seen
    by a gripper that comes straight from the front.

    ## Action Space

    One step is 50 ms (20 Hz) of 25 physics steps.

    ``control_mode="joint_pos"``: `Box((8,), float32)`. Joints move no faster than 2.175 rad/s (joints 1–4) and 2.61
    rad/s (5–7).

    | Num | Action                        | Min     | Max     | Name in the model | Unit |
    |-----|-------------------------------|---------|---------|-------------------|------|
    | 0   | position of joint 1           | -2.8973 | 2.8973  | actuator1         | rad  |
    | 1   | position of joint 2           | -1.7628 | 1.7628  | actuator2         | rad  |
    | 2   | position of joint 3           | -2.8973 | 2.8973  | actuator3         | rad  |
    | 3   | position of joint 4           | -3.0718 | -0.0698 | actuator4         | rad  |
    | 4   | position of joint 5           | -2.8973 | 2.8973  | actuator5         | rad  |
    | 5   | position of joint 6           | -0.0175 | 3.7525  | actuator6         | rad  |
    | 6   | position of joint 7           | -2.8973 | 2.8973  | actuator7         | rad  |
    | 7   | travel of each finger, 0 shut | 0       | 0.04    | gripper           | m    |

    ``control_mode="ee_delta"``: `Box(-1, 1, (7,), float32)`.

    | Num | Action                                       | -1 … 1 stands for | Unit |
    |-----|----------------------------------------------|-------------------|------|
    | 0–2 | translation along the world's x, y, z        | -0.02 … 0.02      | m    |
    | 3–5 | rotation vector about the world's x, y, z    | -0.1 … 0.1        | rad  |
    | 6   | travel of each finger (absolute)             | 0 … 0.04          | m    |

    ## Observation Space

    The robot's base is the origin, the table's top z = 0, x to the front, y to the left.

    ``obs_type="state"``: ``observation`` (120,), ``achieved_goal`` (10,) and ``desired_goal`` (10,).

    | Num    | observation                                             | Unit       |
    |--------|---------------------------------------------------------|------------|
    | 0–6    | joint positions                                         | rad        |
    | 7–13   | joint velocities                                        | rad/s      |
    | 14     | finger coordinate: travel of each finger                | m          |
    | 15     | finger rate                                             | m/s        |
    | 16–22  | gripper pose                                            | –, m       |
    | 23–28  | target velocity: linear, angular, world                 | m/s, rad/s |
    | 29–31  | target half extents along its axes                      | m          |
    | 32–119 | other objects, first those on the table: 8 × (present 0/1, pose 7, half extents 3); 0 if none | –, m |

    ``obs_type="pixels_agent_pos"``: ``pixels`` (``front`` and ``wrist``, each (128, 128, 3) uint8), ``agent_pos`` (8,)
    and ``environment_state`` (105,).

    | Num | agent_pos                                | Unit |
    |-----|------------------------------------------|------|
    | 0–6 | joint positions                          | rad  |
    | 7   | finger coordinate: travel of each finger | m    |

    | Num    | environment_state                                     | Unit |
    |--------|-------------------------------------------------------|------|
    | 0–6    | target pose                                           | –, m |
    | 7–9    | target half extents along its axes                    | m    |
    | 10–16  | goal pose                                             | –, m |
    | 17–104 | other objects: 8 × (present 0/1, pose 7, half extents 3), as above | –, m |

    ## Rewards

    As in `RegraspEnv`, with lever 0.1 m/rad and length 0.2 m.

    ## Starting State

    The scene of the reset's seed, a `TableShelfScene`, with everything at rest.

    ## Episode End

    Termination: none by default; on success with ``terminate_on_success=True``. Truncation: after 1000 steps (50 s).

    ## Arguments

    Those of `RegraspEnv`. ``scene_config`` is a `TableShelfConfig`; cameras are ``"overview"``, ``"front"`` and
    ``"wrist"``.

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, scene_config: TableShelfConfig | None = None, **arguments: Any) -> None:
        super().__init__(PANDA_YCB, scene_config=scene_config or TableShelfConfig(), **arguments)
