"""The environment that all scenarios share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import gymnasium
import numpy as np
from jaxtyping import Float, UInt8

from regrasp_gym.envs import control, observation, reward
from regrasp_gym.envs.planner_task import make_task
from regrasp_gym.errors import EnvError, OptionError, StateError
from regrasp_gym.rendering.renderer import SceneRenderer, halved
from regrasp_gym.rendering.window import Window
from regrasp_gym.scenes.scene import Scene
from regrasp_gym.simulation.scenario import Scenario
from regrasp_gym.simulation.world import World, base_spec

if TYPE_CHECKING:
    from regrasp_planner import Grasp, Plan, PlanOptions, Strategy
    from regrasp_planner.robot.model import Robot
    from regrasp_planner.task import Task

ObsType = Literal["state", "pixels_agent_pos"]
ControlMode = Literal["joint_pos", "ee_delta"]
RewardType = Literal["sparse", "dense"]
RenderMode = Literal["human", "rgb_array"]
Goals = tuple[Float[np.ndarray, " 10"], Float[np.ndarray, " 10"]]


@dataclass(frozen=True, eq=False)
class EnvState:
    """Everything that determines the rest of an episode, except the state of wrappers.

    Attributes:
        joints: names of the arm's joints.
        scene: the scene.
        physics: (s,) MuJoCo's mjSTATE_INTEGRATION.
        command: (n + 1,) last command of the controller.
        elapsed: steps since the reset.
        random: state of the generator that draws scene seeds.
    """

    joints: tuple[str, ...]
    scene: Scene
    physics: Float[np.ndarray, " s"]
    command: Float[np.ndarray, " n+1"]
    elapsed: int
    random: Mapping[str, Any]


class RegraspEnv(gymnasium.Env):
    """Pick-and-place that may need a regrasp, for any scenario.

    Subclasses document the robot, the task, the tables of actions and observations, and the numbers of their scenario.
    The rest holds for every environment.

    ## Action Space

    Out-of-range entries are clipped. Wrong shapes and entries that are not finite raise `ActionError`.

    ``control_mode="joint_pos"``: joint positions and the finger coordinate. Joints move to their positions in a
    straight line, no faster than their maximum velocities, so a distant position takes several steps.

    ``control_mode="ee_delta"``: `Box(-1, 1, (7,), float32)`, a motion of the gripper frame: between the finger pads, z
    out of the palm, fingers close along y. It starts from the last commanded pose. The joints follow by damped least
    squares within their limits.

    The set points move in a straight line over the physics steps of an environment step.

    ## Observation Space

    Poses are a unit quaternion (w, x, y, z) and a position in the world frame. Of the two quaternions of a rotation,
    observations give the one with w + 0.41 x + 0.33 y + 0.27 z ≥ 0. All vectors are float64 and unbounded.

    ``obs_type="state"`` is a dictionary of ``observation``, ``achieved_goal`` and ``desired_goal``.

    | Num | achieved_goal, desired_goal                                                          | Unit |
    |-----|--------------------------------------------------------------------------------------|------|
    | 0–6 | pose of the target                                                                   | –, m |
    | 7   | 1 if it moves or only the gripper supports it, else 0; desired: 0                    | –    |
    | 8   | 1 if the gripper touches it, else 0; desired: 0                                      | –    |
    | 9   | distance of the gripper frame from the target's centre; desired: 0, never compared   | m    |

    Where the target has to be held at the goal, entry 7 is 1 unless the gripper alone supports it, and entry 8 of the
    desired goal is 1.

    ``obs_type="pixels_agent_pos"`` is a dictionary of ``pixels`` (by camera, each (H, W, 3) uint8, rows from the top),
    ``agent_pos`` and ``environment_state``.

    ## Rewards

    - *sparse*: 0 on success, else -1.
    - *dense*: 0 on success, else -1 + 0.25 reach + 0.7 closeness, in [-1, -0.05]:
      closeness = 1 - tanh((d + lever · angle) / length), with the target's distance d and angle from its goal;
      reach = 1 - tanh(distance of the gripper frame from the target / length), and 1 once the target is in place.

    Success: the pose is within tolerance, and entries 7 and 8 of the achieved goal do not exceed those of the desired
    goal. ``info["is_success"]`` is true exactly where the reward is 0. It describes the current step, and turns false
    again if the target is moved.

    With ``obs_type="state"``, ``compute_reward(achieved_goal, desired_goal, info)`` gives the same reward for single
    goals and for batches, and ignores ``info``. A relabelled goal is reached by the state that it comes from: for
    example, one in which the target is held is reached by holding it there.

    ## Starting State

    The scene of the reset's seed, with everything at rest. Without a seed, the scene's seed is drawn from the
    environment's generator. ``reset(options={"scene": s})`` takes the scene of seed s, or s itself if it is a `Scene`.
    Two resets with one seed give the same state to the last bit, whatever happened in between.

    ``info`` holds ``is_success`` and ``scene_seed``, after a reset also ``instruction`` (the task in words) and
    ``target`` (the object's name).

    ## Episode End

    Termination: none by default, as usual for goal environments; on success with ``terminate_on_success=True``.
    Truncation: after the registered number of steps.

    ## Arguments

    Args:
        scenario: robot, scenes and conventions; subclasses set it.
        obs_type: ``"state"`` (the default) or ``"pixels_agent_pos"``.
        control_mode: ``"joint_pos"`` (the default) or ``"ee_delta"``.
        reward_type: ``"sparse"`` (the default) or ``"dense"``.
        render_mode: None (the default), ``"rgb_array"`` or ``"human"``.
        scene_config: configuration of the scenes; None for the scenario's default.
        image_size: height and width of observed pictures, pixels; by default (128, 128).
        render_size: height and width of pictures from `render`, pixels; by default (480, 640).
        render_camera: camera of `render`; by default ``"overview"``.
        terminate_on_success: end the episode on success; by default False.

    Raises:
        OptionError: an argument has an unknown value.
        DisplayError: ``"human"`` without a display.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        obs_type: ObsType = "state",
        control_mode: ControlMode = "joint_pos",
        reward_type: RewardType = "sparse",
        render_mode: RenderMode | None = None,
        scene_config: object = None,
        image_size: tuple[int, int] = (128, 128),
        render_size: tuple[int, int] = (480, 640),
        render_camera: str = "overview",
        terminate_on_success: bool = False,
    ) -> None:
        _check("obs_type", obs_type, get_args(ObsType))
        _check("control_mode", control_mode, get_args(ControlMode))
        _check("reward_type", reward_type, get_args(RewardType))
        _check("render_mode", render_mode, (None, *get_args(RenderMode)))
        self.scenario = scenario
        self.obs_type, self.control_mode, self.reward_type = obs_type, control_mode, reward_type
        self.render_mode = render_mode
        self.scene_config = scene_config
        self.image_size, self.render_size, self.render_camera = image_size, render_size, render_camera
        self.terminate_on_success = terminate_on_success

        # Pictures for people are rendered at twice their size and halved.
        drawn = np.maximum(
            image_size if obs_type != "state" else (1, 1), np.multiply(render_size, 2 * bool(render_mode))
        )
        self._base = base_spec(scenario, buffer_height=int(drawn[0]), buffer_width=int(drawn[1]))
        self._renderer = SceneRenderer(height=int(drawn[0]), width=int(drawn[1]))
        self._window = Window(scenario.control_period) if render_mode == "human" else None
        self._control = self._make_control()
        self._reward = reward.REWARDS[reward_type]
        self._world: World | None = None
        self._command = np.append(scenario.robot.home, scenario.robot.theta_range[1])
        self._elapsed = 0

        self.action_space = self._control.action_space
        joints = len(scenario.robot.arm_joints)
        if obs_type == "state":
            self.observation_space = observation.state_space(joints, scenario.max_others)
        else:
            self.observation_space = observation.pixels_space(joints, scenario.max_others, scenario.pixels, *image_size)

    # Gymnasium --------------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seed of the scene; drawn from the environment's generator if None.
            options: ``{"scene": s}`` takes the scene of seed s, or s itself if it is a scene.

        Raises:
            OptionError: unknown option, or neither a scene nor a seed.
            SceneError: the scene cannot be made.
        """
        super().reset(seed=seed)
        scene = self._chosen_scene(seed, options or {})
        self._world = World(self._base, self.scenario.robot, scene)
        self._command = np.append(self.scenario.robot.home, self.scenario.robot.theta_range[1])
        self._elapsed = 0
        self._show()
        goals = self._goals()
        return self._observe(goals), self._info(goals) | {"instruction": scene.instruction, "target": scene.target.name}

    def step(self, action: Float[np.ndarray, " m"]) -> tuple[dict, float, bool, bool, dict[str, Any]]:
        """Act for one control period.

        Raises:
            ActionError: wrong shape, or not finite. Out-of-range entries are clipped.
        """
        world = self.world
        last = self._command
        self._command = self._control.command(control.check_action(action, self._control.action_space), last)
        world.run(last, self._command, round(self.scenario.control_period / world.model.opt.timestep))
        self._elapsed += 1
        self._show()
        goals = self._goals()
        info = self._info(goals)
        earned = self._reward(*goals, self.scenario.tolerance)
        return self._observe(goals), float(earned), self.terminate_on_success and info["is_success"], False, info

    def render(self) -> UInt8[np.ndarray, "H W 3"] | None:
        """A picture of the current state; None unless the render mode is ``"rgb_array"``."""
        if self.render_mode != "rgb_array":
            return None
        return self.picture(self.render_camera, *self.render_size)

    def close(self) -> None:
        """Close the window and free the renderer."""
        self._renderer.close()
        if self._window is not None:
            self._window.close()

    @property
    def compute_reward(self):
        """Reward function (achieved, desired, info) of a goal environment; ignores ``info``.

        Only observations of type ``state`` have goals. With others the attribute is missing, because libraries take an
        environment that has it for a goal environment.
        """
        if self.obs_type != "state":
            raise AttributeError(f"compute_reward needs obs_type='state'; this environment has {self.obs_type!r}")
        return self._compute_reward

    def _compute_reward(
        self, achieved_goal: Float[np.ndarray, "*batch 10"], desired_goal: Float[np.ndarray, "*batch 10"], info: object
    ) -> Float[np.ndarray, "*batch"]:
        del info
        return self._reward(np.asarray(achieved_goal), np.asarray(desired_goal), self.scenario.tolerance)

    # For experts, collectors and tests --------------------------------------------------------------------------

    @property
    def world(self) -> World:
        """The physics of the current episode."""
        if self._world is None:
            raise gymnasium.error.ResetNeeded("call reset() first: there is no scene yet")
        return self._world

    @property
    def scene(self) -> Scene:
        """The scene of the current episode."""
        return self.world.scene

    @property
    def task_description(self) -> str:
        """The task in words, for example "put the sugar box upright on the shelf"."""
        return self.scene.instruction

    @property
    def command(self) -> Float[np.ndarray, " n+1"]:
        """(n + 1,) last command of the controller: joint positions (radians), θ."""
        return self._command.copy()

    @property
    def is_success(self) -> bool:
        """Whether the target counts as placed now, as in ``info["is_success"]``."""
        return bool(reward.is_success(*self._goals(), self.scenario.tolerance))

    def action_toward(self, command: Float[np.ndarray, " n+1"]) -> Float[np.ndarray, " m"]:
        """The action (float32, in the action space) that comes nearest to a command (n + 1,)."""
        space = self._control.action_space
        action = self._control.toward(command, self._command).astype(np.float32)
        return np.clip(action, space.low, space.high)

    def effort(self, command: Float[np.ndarray, " n+1"]) -> float:
        """Least number of steps that the arm needs from the last command to this one (n + 1,)."""
        return self._control.effort(command, self._command)

    @property
    def planner_robot(self) -> Robot:
        """The planner's robot, built once from the simulated model."""
        return _planner_robot(self.scenario)

    def task(self) -> Task:
        """The planner's task, with all objects where they are now."""
        return make_task(self.world)

    def plan(
        self,
        strategy: Strategy | str,
        seed: int = 0,
        options: PlanOptions | None = None,
        known_grasps: Sequence[Grasp] = (),
    ) -> Plan:
        """A plan from the current state, for the expert to follow. See `regrasp_planner.plan`.

        Args:
            strategy: see `regrasp_planner.Strategy`.
            seed: seed of the random starts.
            options: `plan_options` if None.
            known_grasps: tried before any are generated.
        """
        # Imported here because it loads JAX, which stepping an environment does not need.
        from regrasp_planner import Strategy

        return self._plan(Strategy(strategy), seed, options or self.plan_options(), known_grasps)

    def _plan(self, strategy: Strategy, seed: int, options: PlanOptions, known_grasps: Sequence[Grasp]) -> Plan:
        """For environments to override whose goal is not a place to put something down."""
        from regrasp_planner import plan

        return plan(self.task(), self.planner_robot, strategy, seed, options, known_grasps)

    def plan_options(self) -> PlanOptions:
        """The planner's effort in these scenes."""
        from regrasp_planner import PlanOptions

        return PlanOptions()

    def picture(self, camera: str, height: int, width: int) -> UInt8[np.ndarray, "H W 3"]:
        """An antialiased picture from any camera of the model, with a translucent target at the goal.

        Raises:
            OptionError: the picture is larger than ``render_size``, or there is no render mode.
        """
        if not self.render_mode or height > self.render_size[0] or width > self.render_size[1]:
            raise OptionError(
                f"a picture of {height}×{width} pixels does not fit the buffer; make the environment with "
                f"render_mode='rgb_array' and render_size=({height}, {width})"
            )
        world = self.world
        large = self._renderer.render(world.model, world.data, camera, 2 * width, 2 * height, show_goal=True)
        return halved(large)

    def get_state(self) -> EnvState:
        """Everything that determines the rest of the episode; `set_state` continues from it to the last bit."""
        random = self.np_random.bit_generator.state
        world = self.world
        joints = self.scenario.robot.arm_joints
        return EnvState(joints, world.scene, world.get_state(), self._command.copy(), self._elapsed, random)

    def set_state(self, state: EnvState) -> dict:
        """Restore a saved state of this environment, or of another of the same id, and return its observation.

        Raises:
            StateError: not a saved state, another robot's, or with more objects than observations have room for.
        """
        if not isinstance(state, EnvState):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise StateError(f"{type(state).__name__} is not a saved state; give the result of get_state()")
        if state.joints != self.scenario.robot.arm_joints:
            raise StateError(f"the state is of another robot, with joints {', '.join(state.joints)}; restore it there")
        self._check_room(state.scene, StateError)
        if self._world is None or state.scene is not self._world.scene:
            self._world = World(self._base, self.scenario.robot, state.scene)
        self._world.set_state(state.physics)
        self._command = state.command.copy()
        self._elapsed = state.elapsed
        self.np_random.bit_generator.state = state.random
        return self._observe(self._goals())

    @property
    def elapsed(self) -> int:
        """Steps since the reset."""
        return self._elapsed

    # Internals ----------------------------------------------------------------------------------------------------

    def _chosen_scene(self, seed: int | None, options: dict[str, Any]) -> Scene:
        unknown = set(options) - {"scene"}
        if unknown:
            raise OptionError(f"unknown reset option {sorted(unknown)[0]!r}; the only one is 'scene'")
        wanted = options.get("scene")
        # Drawn even if unused, so that later scenes do not depend on the options.
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        if wanted is None:
            return self.scenario.make_scene(drawn, self.scene_config)
        if isinstance(wanted, (int, np.integer)) and not isinstance(wanted, bool):
            return self.scenario.make_scene(int(wanted), self.scene_config)
        if isinstance(wanted, Scene):
            self._check_room(wanted, OptionError)
            return wanted
        raise OptionError(f"option 'scene' is {wanted!r}; give a scene or its seed")

    def _check_room(self, scene: Scene, error: type[EnvError]) -> None:
        if len(scene.others) > self.scenario.max_others:
            raise error(
                f"the scene has {len(scene.others)} objects besides the target; observations have room for "
                f"{self.scenario.max_others}; give one with fewer"
            )

    def _make_control(self) -> control.Control:
        robot = self.scenario.robot
        model = robot.build_spec().compile()
        ranges = np.array([model.joint(name).range for name in robot.arm_joints])
        limits = control.CommandLimits(
            lower=np.append(ranges[:, 0], robot.theta_range[0]),
            upper=np.append(ranges[:, 1], robot.theta_range[1]),
            step=robot.max_velocity * self.scenario.control_period,
        )
        if self.control_mode == "joint_pos":
            return control.JointPositionControl(limits)
        return control.EndEffectorDeltaControl(
            limits,
            model,
            robot.arm_joints,
            robot.tcp_site,
            self.scenario.translation_step,
            self.scenario.rotation_step,
        )

    def _goals(self) -> Goals:
        """Achieved and desired goal, computed once per step: contacts and poses take time."""
        world, held = self.world, self.scenario.held
        return observation.achieved_goal(world, self.scenario.tolerance, held), observation.desired_goal(world, held)

    def _observe(self, goals: Goals) -> dict:
        world, room = self.world, self.scenario.max_others
        if self.obs_type == "state":
            return {
                "observation": observation.state_vector(world, room),
                "achieved_goal": goals[0],
                "desired_goal": goals[1],
            }
        height, width = self.image_size
        return {
            "pixels": {
                camera: self._renderer.render(world.model, world.data, camera, width, height)
                for camera in self.scenario.pixels
            },
            "agent_pos": observation.agent_vector(world),
            "environment_state": observation.environment_vector(world, room),
        }

    def _info(self, goals: Goals) -> dict[str, Any]:
        success = bool(reward.is_success(*goals, self.scenario.tolerance))
        return {"is_success": success, "scene_seed": self.scene.seed}

    def _show(self) -> None:
        if self._window is not None:
            self._window.show(self.world.model, self.world.data)


@lru_cache(maxsize=8)
def _planner_robot(scenario: Scenario) -> Robot:
    return scenario.robot.planner_robot()


def _check(name: str, value: object, allowed: tuple[object, ...]) -> None:
    if value not in allowed:
        raise OptionError(f"{name}={value!r} is unknown; choose one of {', '.join(map(repr, allowed))}")
