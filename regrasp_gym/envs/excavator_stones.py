"""Excavator with stones: from one slope onto another slope, or onto another stone."""

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
    """Take a stone from others on one slope and lay it among others on another slope, or on top of one.

    What is not said here is in `RegraspEnv`.

    **Task.** A 21 t excavator with a tiltrotator and a two-jaw stone grapple stands between two slopes of earth. The
    target lies among other stones on the slope to the machine's right. It belongs on the slope to its left, often on
    another of its sides. The grapple cannot grasp it from below. Then it has to be put down on the flat ground in front
    of the machine and grasped again another way.

    **Randomizations.** From the scene's seed: the stones (convex, 12–60 corners, 100–1,000 kg); the slopes (their
    inclination, 5–18°, and downhill directions); the number of stones on each slope, the sides they lie on and the gaps
    between them; and the goal. `SlopesConfig` holds the ranges. The machine always starts facing forward, the grapple
    pointing down with open jaws.

    **Success.** The target is within 0.2 m and 15° of the goal pose, moves no faster than 40 mm/s and 0.1 rad/s,
    something other than the grapple supports it, and the grapple does not touch it.

    **Goal.** A pose of the target at rest: on one of its sides on the left slope, or on a side of another stone.

    ## Action Space

    One step is 100 ms (10 Hz) of 50 physics steps.

    ``control_mode="joint_pos"``: `Box((7,), float32)`. Joints move no faster than 0.5, 0.25, 0.5, 0.6, 0.4 and 0.8
    rad/s.

    | Num | Action                                    | Min     | Max    | Name in the model | Unit |
    |-----|-------------------------------------------|---------|--------|-------------------|------|
    | 0   | swing of the house                        | -3.1416 | 3.1416 | actuator_swing    | rad  |
    | 1   | boom, greater is lower                    | -1.137  | 1      | actuator_boom     | rad  |
    | 2   | arm (stick), greater is further in        | 0.594   | 2.687  | actuator_arm      | rad  |
    | 3   | pitch of the tool                         | -0.54   | 1.83   | actuator_pitch    | rad  |
    | 4   | tilt of the tool                          | -0.7854 | 0.7854 | actuator_tilt     | rad  |
    | 5   | rotation of the tool                      | -3.1416 | 3.1416 | actuator_rotate   | rad  |
    | 6   | angle of each jaw, greater is wider       | -0.4237 | 0.2014 | gripper           | rad  |

    ``control_mode="ee_delta"``: `Box(-1, 1, (7,), float32)`, the jaws being the fingers.

    | Num | Action                                       | -1 … 1 stands for | Unit |
    |-----|----------------------------------------------|-------------------|------|
    | 0–2 | translation along the world's x, y, z        | -0.2 … 0.2        | m    |
    | 3–5 | rotation vector about the world's x, y, z    | -0.1 … 0.1        | rad  |
    | 6   | angle of each jaw (absolute)                 | -0.4237 … 0.2014  | rad  |

    ## Observation Space

    The origin is on the swing axis at ground level, z = 0 is the ground, x to the front, y to the left.

    ``obs_type="state"``: ``observation`` (140,), ``achieved_goal`` (10,) and ``desired_goal`` (10,).

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

    ``obs_type="pixels_agent_pos"``: ``pixels`` (``site`` from outside and ``cab`` from the operator's seat, each
    (128, 128, 3) uint8), ``agent_pos`` (7,) and ``environment_state`` (127,).

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

    As in `RegraspEnv`, with lever 0.5 m/rad and length 3 m.

    ## Starting State

    The scene of the reset's seed, a `SlopesScene`, with everything at rest.

    ## Episode End

    Termination: none by default; on success with ``terminate_on_success=True``. Truncation: after 2000 steps (200 s).

    ## Arguments

    Those of `RegraspEnv`. ``scene_config`` is a `SlopesConfig`; cameras are ``"overview"``, ``"site"`` and ``"cab"``.

    ## Version History

    * v0: first version.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, scene_config: SlopesConfig | None = None, **arguments: Any) -> None:
        super().__init__(EXCAVATOR_STONES, scene_config=scene_config or SlopesConfig(), **arguments)

    def plan_options(self) -> PlanOptions:
        """More effort than for the Panda: round pads allow many more grasps of a stone, and few suit both slopes.

        Grasp axes may lean from the contact normals as far as friction allows. Release positions nearer to the machine
        and further away suit the boom.
        """
        from regrasp_planner import GraspGenOptions, PlanOptions

        return PlanOptions(
            grasp=GraspGenOptions(lean=0.25, max_axes=32, angles=24, deep=0.5, screened=96, refined=16, budget=300),
            regrasp=GraspGenOptions(lean=0.25, max_axes=24, screened=48, budget=800),
            motion_attempts=16,
            grasps_kept=6,
            release_positions=((0.0, 0.0), (-0.9, 0.0), (0.9, 0.0)),
        )
