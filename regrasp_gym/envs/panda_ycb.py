"""Panda with YCB objects: from a cluttered table, upright onto a shelf."""

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
"""The Panda on its table, with the shelf beside it."""


class PandaYCBEnv(RegraspEnv):
    """Take an object from among others on a table and stand it upright among others on a shelf.

    **Task.** A Franka Panda with a parallel gripper stands on a table. The target is the object that the goal is for;
    it lies among clutter to the robot's right and belongs on the shelf to its left. Often no single grasp fits both
    places: then the target has to be put down on the free patch of table in between, and taken again another way.

    **Randomizations.** From the scene's seed: which object is the target (boxes, cans and bottles of the YCB set);
    which 3–5 objects lie around it and which 2–3 stand on the shelf; the resting pose of everything on the table
    (drawn by the probability that a dropped object lands in it, the target's among those in which the gripper fits
    over it), positions and turns. `TableShelfConfig` holds the ranges. The robot always starts in its ready
    configuration with the gripper open.

    **Success.** The target is within 25 mm and 15° of the goal pose, moves no faster than 10 mm/s and 0.2 rad/s,
    something other than the gripper supports it, and the gripper does not touch it. ``info["is_success"]`` says so for
    the present step; it can turn false again if the target is touched or moved.

    **Goal.** A pose of the target: upright on the shelf's board, its narrow sides within 29° of where they are to the
    left and right of a gripper that comes straight from the front.

    ## Action Space

    ``control_mode="joint_pos"``: `Box((8,), float32)`. Out-of-range entries are clipped; entries that are not finite
    and wrong shapes raise `ActionError`. Joints move to their positions in a straight line and no faster than 2.175
    rad/s (joints 1–4) and 2.61 rad/s (5–7), so that a far position takes several steps.

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

    ``control_mode="ee_delta"``: `Box(-1, 1, (7,), float32)`. The commanded pose of the gripper frame (between the
    finger pads, z out of the palm, fingers close along y) moves from where it was commanded last, and the joints follow
    by damped least squares within their limits.

    | Num | Action                                       | -1 … 1 stands for | Unit |
    |-----|----------------------------------------------|-------------------|------|
    | 0–2 | move along the world's x, y, z               | -0.02 … 0.02      | m    |
    | 3–5 | rotation vector about the world's x, y, z    | -0.1 … 0.1        | rad  |
    | 6   | travel of each finger (absolute)             | 0 … 0.04          | m    |

    One step is 50 ms (20 Hz) of 25 physics steps; the set points move in a straight line over them.

    ## Observation Space

    Poses are unit quaternion (w, x, y, z) and position, in the world: the robot's base is the origin, the table's top
    z = 0, x to the front, y to the left. Of a rotation's two quaternions it is the one with
    w + 0.41 x + 0.33 y + 0.27 z ≥ 0. All vectors are float64 and unbounded.

    ``obs_type="state"``: a dictionary with ``observation`` (120,), ``achieved_goal`` (10,) and ``desired_goal`` (10,).

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

    | Num | achieved_goal, desired_goal                                                          | Unit |
    |-----|--------------------------------------------------------------------------------------|------|
    | 0–6 | pose of the target                                                                   | –, m |
    | 7   | 1 if it moves or only the gripper supports it, else 0; desired: 0                    | –    |
    | 8   | 1 if the gripper touches it, else 0; desired: 0                                      | –    |
    | 9   | distance of the gripper frame from the target's centre; desired: 0, never compared   | m    |

    ``obs_type="pixels_agent_pos"``: a dictionary with ``pixels`` (``front`` and ``wrist``, each (128, 128, 3) uint8,
    rows from the top), ``agent_pos`` (8,) and ``environment_state`` (105,).

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

    - *sparse*: 0 on success, else -1.
    - *dense*: 0 on success, else -1 + 0.25 reach + 0.7 closeness, in [-1, -0.05]:
      closeness = 1 - tanh((d + 0.1 m/rad · angle) / 0.2 m) with the target's distance d and angle from its goal;
      reach = 1 - tanh(distance of the gripper frame from the target / 0.2 m), and 1 once the target is in place.

    With ``obs_type="state"``, ``compute_reward(achieved_goal, desired_goal, info)`` gives the same reward for single
    goals and for batches, without using ``info``. Success of any two goals: pose within tolerance, and entries 7 and 8
    of the achieved goal not above those of the desired one. So ``info["is_success"]`` is true exactly where the reward
    is 0, and a relabelled goal in which the target is held is reached by holding it there.

    ## Starting State

    The scene of the reset's seed, everything at rest. Without a seed, the scene's seed is drawn from the environment's
    generator. ``reset(options={"scene": s})`` takes the scene of seed s, or s itself if it is a `TableShelfScene`.
    Two resets with one seed give the same state to the last bit, whatever happened in between.
    ``info`` holds ``is_success`` and ``scene_seed``, after a reset also ``instruction`` (the task in words) and
    ``target`` (the object's name).

    ## Episode End

    ### Termination
    None by default, as usual for goal environments. With ``terminate_on_success=True``, on success.

    ### Truncation
    After 1000 steps (50 s), by the time limit it is registered with.

    ## Arguments

    | Parameter              | Type                | Default        | Description                                   |
    |------------------------|---------------------|----------------|-----------------------------------------------|
    | `obs_type`             | str                 | `"state"`      | `"state"` or `"pixels_agent_pos"`             |
    | `control_mode`         | str                 | `"joint_pos"`  | `"joint_pos"` or `"ee_delta"`                 |
    | `reward_type`          | str                 | `"sparse"`     | `"sparse"` or `"dense"`                       |
    | `render_mode`          | str or None         | `None`         | `"rgb_array"` or `"human"`                    |
    | `scene_config`         | `TableShelfConfig`  | the default    | ranges of the scenes                          |
    | `image_size`           | (int, int)          | `(128, 128)`   | height and width of observed pictures         |
    | `render_size`          | (int, int)          | `(480, 640)`   | height and width of `render()`                |
    | `render_camera`        | str                 | `"overview"`   | `"overview"`, `"front"` or `"wrist"`          |
    | `terminate_on_success` | bool                | `False`        | end the episode on success                    |

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, scene_config: TableShelfConfig | None = None, **arguments: Any) -> None:
        super().__init__(PANDA_YCB, scene_config=scene_config or TableShelfConfig(), **arguments)
