"""Excavator with stones: from a heap on one slope onto another slope, or onto another stone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.rendering.setting import SITE, Camera
from regrasp_gym.robots.excavator import EXCAVATOR
from regrasp_gym.scenes.slopes import make_scene
from regrasp_gym.scenes.slopes_config import MAX_OTHERS, SlopesConfig
from regrasp_gym.simulation.scenario import Scenario, Tolerance

if TYPE_CHECKING:
    from regrasp_planner import PlanOptions

EXCAVATOR_STONES = Scenario(
    robot=EXCAVATOR,
    make_scene=make_scene,
    control_period=0.1,
    tolerance=Tolerance(position=0.2, rotation=float(np.deg2rad(15)), speed=0.04, turn_rate=0.1, lever=0.5, length=3.0),
    arrival=0.002,
    pace=4.0,
    max_others=MAX_OTHERS,
    translation_step=0.2,
    rotation_step=0.1,
    cameras=(
        Camera("site", (13.5, 0.0, 7.5), (3.2, 0.0, 0.6), 62.0),
        Camera("overview", (12.5, -11.0, 7.5), (3.4, 0.2, 0.8), 50.0),
    ),
    pixels=("site", "cab"),
    floor_height=-0.5,
    setting=SITE,
)
"""The excavator between its two slopes."""


class ExcavatorStonesEnv(RegraspEnv):
    """Take a stone from among others on one slope and lay it among others on another slope, or on top of one.

    **Task.** A 21 t excavator with a tiltrotator and a two-jaw stone grapple stands between two slopes of earth. The
    target is the stone that the goal is for; it lies among others on the slope to the machine's right and belongs on
    the slope to its left, often on another of its sides. The grapple cannot take it from below: then the stone has to
    be put down on the flat ground in front of the machine, and taken again another way.

    **Randomizations.** From the scene's seed: the stones (convex, 12–60 corners, 100–1,000 kg), the slopes (their
    inclination, 5–18°, and which way they fall), how many stones lie where, on which of their sides and how near to
    each other, and the goal. `SlopesConfig` holds the ranges. The machine always starts facing forward, the grapple
    pointing down with open jaws.

    **Success.** The target is within 0.2 m and 15° of the goal pose, moves no faster than 40 mm/s and 0.1 rad/s,
    something other than the grapple supports it, and the grapple does not touch it. ``info["is_success"]`` says so for
    the present step; it can turn false again if the target is touched or moved.

    **Goal.** A pose of the target at rest: on one of its sides on the left slope, or on a side of another stone.

    ## Action Space

    ``control_mode="joint_pos"``: `Box((7,), float32)`. Out-of-range entries are clipped; entries that are not finite
    and wrong shapes raise `ActionError`. Joints move to their positions in a straight line and no faster than 0.5,
    0.25, 0.5, 0.6, 0.4 and 0.8 rad/s, so that a far position takes many steps.

    | Num | Action                                    | Min     | Max    | Name in the model | Unit |
    |-----|-------------------------------------------|---------|--------|-------------------|------|
    | 0   | swing of the house                        | -3.1416 | 3.1416 | actuator_swing    | rad  |
    | 1   | boom, greater is lower                    | -1.137  | 1      | actuator_boom     | rad  |
    | 2   | arm (stick), greater is further in        | 0.594   | 2.687  | actuator_arm      | rad  |
    | 3   | pitch of the tool                         | -0.54   | 1.83   | actuator_pitch    | rad  |
    | 4   | tilt of the tool                          | -0.7854 | 0.7854 | actuator_tilt     | rad  |
    | 5   | rotation of the tool                      | -3.1416 | 3.1416 | actuator_rotate   | rad  |
    | 6   | angle of each jaw, greater is wider       | -0.4237 | 0.2014 | gripper           | rad  |

    ``control_mode="ee_delta"``: `Box(-1, 1, (7,), float32)`. The commanded pose of the gripper frame (between the
    pads, z out of the palm, jaws close along y) moves from where it was commanded last, and the joints follow by damped
    least squares within their limits.

    | Num | Action                                       | -1 … 1 stands for | Unit |
    |-----|----------------------------------------------|-------------------|------|
    | 0–2 | move along the world's x, y, z               | -0.2 … 0.2        | m    |
    | 3–5 | rotation vector about the world's x, y, z    | -0.1 … 0.1        | rad  |
    | 6   | angle of each jaw (absolute)                 | -0.4237 … 0.2014  | rad  |

    One step is 100 ms (10 Hz) of 50 physics steps; the set points move in a straight line over them.

    ## Observation Space

    Poses are unit quaternion (w, x, y, z) and position, in the world: the swing axis is the origin, the ground z = 0, x
    to the front, y to the left. Of a rotation's two quaternions it is the one with
    w + 0.41 x + 0.33 y + 0.27 z ≥ 0. All vectors are float64 and unbounded.

    ``obs_type="state"``: a dictionary with ``observation`` (140,), ``achieved_goal`` (10,) and ``desired_goal`` (10,).

    | Num    | observation                                             | Unit       |
    |--------|---------------------------------------------------------|------------|
    | 0–5    | joint positions                                         | rad        |
    | 6–11   | joint velocities                                        | rad/s      |
    | 12     | finger coordinate: angle of each jaw                    | rad        |
    | 13     | finger rate                                             | rad/s      |
    | 14–20  | gripper pose                                            | –, m       |
    | 21–26  | target velocity: linear, angular, world                 | m/s, rad/s |
    | 27–29  | target half extents along its axes                      | m          |
    | 30–139 | other objects, right slope first: 10 × (present 0/1, pose 7, half extents 3); 0 if none | –, m |

    | Num | achieved_goal, desired_goal                                                          | Unit |
    |-----|--------------------------------------------------------------------------------------|------|
    | 0–6 | pose of the target                                                                   | –, m |
    | 7   | 1 if it moves or only the gripper supports it, else 0; desired: 0                    | –    |
    | 8   | 1 if the gripper touches it, else 0; desired: 0                                      | –    |
    | 9   | distance of the gripper frame from the target's centre; desired: 0, never compared   | m    |

    ``obs_type="pixels_agent_pos"``: a dictionary with ``pixels`` (``site`` from outside and ``cab`` from the operator's
    seat, each (128, 128, 3) uint8, rows from the top), ``agent_pos`` (7,) and ``environment_state`` (127,).

    | Num | agent_pos                            | Unit |
    |-----|--------------------------------------|------|
    | 0–5 | joint positions                      | rad  |
    | 6   | finger coordinate: angle of each jaw | rad  |

    | Num    | environment_state                                     | Unit |
    |--------|-------------------------------------------------------|------|
    | 0–6    | target pose                                           | –, m |
    | 7–9    | target half extents along its axes                    | m    |
    | 10–16  | goal pose                                             | –, m |
    | 17–126 | other objects: 10 × (present 0/1, pose 7, half extents 3), as above | –, m |

    ## Rewards

    - *sparse*: 0 on success, else -1.
    - *dense*: 0 on success, else -1 + 0.25 reach + 0.7 closeness, in [-1, -0.05]:
      closeness = 1 - tanh((d + 0.5 m/rad · angle) / 3 m) with the target's distance d and angle from its goal;
      reach = 1 - tanh(distance of the gripper frame from the target / 3 m), and 1 once the target is in place.

    With ``obs_type="state"``, ``compute_reward(achieved_goal, desired_goal, info)`` gives the same reward for single
    goals and for batches, without using ``info``. Success of any two goals: pose within tolerance, and entries 7 and 8
    of the achieved goal not above those of the desired one. So ``info["is_success"]`` is true exactly where the reward
    is 0, and a relabelled goal in which the target is held is reached by holding it there.

    ## Starting State

    The scene of the reset's seed, everything at rest. Without a seed, the scene's seed is drawn from the environment's
    generator. ``reset(options={"scene": s})`` takes the scene of seed s, or s itself if it is a `SlopesScene`.
    Two resets with one seed give the same state to the last bit, whatever happened in between.
    ``info`` holds ``is_success`` and ``scene_seed``, after a reset also ``instruction`` (the task in words) and
    ``target`` (the object's name).

    ## Episode End

    ### Termination
    None by default, as usual for goal environments. With ``terminate_on_success=True``, on success.

    ### Truncation
    After 2000 steps (200 s), by the time limit it is registered with.

    ## Arguments

    | Parameter              | Type                | Default        | Description                                   |
    |------------------------|---------------------|----------------|-----------------------------------------------|
    | `obs_type`             | str                 | `"state"`      | `"state"` or `"pixels_agent_pos"`             |
    | `control_mode`         | str                 | `"joint_pos"`  | `"joint_pos"` or `"ee_delta"`                 |
    | `reward_type`          | str                 | `"sparse"`     | `"sparse"` or `"dense"`                       |
    | `render_mode`          | str or None         | `None`         | `"rgb_array"` or `"human"`                    |
    | `scene_config`         | `SlopesConfig`      | the default    | ranges of the scenes                          |
    | `image_size`           | (int, int)          | `(128, 128)`   | height and width of observed pictures         |
    | `render_size`          | (int, int)          | `(480, 640)`   | height and width of `render()`                |
    | `render_camera`        | str                 | `"overview"`   | `"overview"`, `"site"` or `"cab"`             |
    | `terminate_on_success` | bool                | `False`        | end the episode on success                    |

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, scene_config: SlopesConfig | None = None, **arguments: Any) -> None:
        super().__init__(EXCAVATOR_STONES, scene_config=scene_config or SlopesConfig(), **arguments)

    def plan_options(self) -> PlanOptions:
        """More effort than for the Panda: round pads hold stones by many more grasps, of which few suit both slopes.

        Starts are taken along axes that lean against the contact normals, too, as far as friction allows. Stones are
        put down nearer to the machine or further off where the boom wants it.
        """
        from regrasp_planner import GraspGenOptions, PlanOptions

        return PlanOptions(
            grasp=GraspGenOptions(lean=0.25, max_axes=32, angles=24, deep=0.5, screened=96, refined=16, budget=300),
            regrasp=GraspGenOptions(lean=0.25, max_axes=24, screened=48, budget=800),
            motion_attempts=16,
            grasps_kept=6,
            release_positions=((0.0, 0.0), (-0.9, 0.0), (0.9, 0.0)),
        )
