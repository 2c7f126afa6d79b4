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
    """Everything that the future of an episode depends on, wrappers excepted.

    Attributes:
        joints: names of the arm's joints.
        scene: the scene.
        physics: (s,) state of the simulation, MuJoCo's mjSTATE_INTEGRATION.
        command: (n + 1,) last command of the controller.
        elapsed: steps since the reset.
        random: state of the generator that draws the next scene's seed.
    """

    joints: tuple[str, ...]
    scene: Scene
    physics: Float[np.ndarray, " s"]
    command: Float[np.ndarray, " n+1"]
    elapsed: int
    random: Mapping[str, Any]


class RegraspEnv(gymnasium.Env):
    """Pick-and-place in which one grasp may not be enough, for any scenario.

    Subclasses document what it means for their scenario.

    Args:
        scenario: robot, scenes and conventions.
        obs_type: ``"state"`` or ``"pixels_agent_pos"``.
        control_mode: ``"joint_pos"`` or ``"ee_delta"``.
        reward_type: ``"sparse"`` or ``"dense"``.
        render_mode: None, ``"rgb_array"`` or ``"human"``.
        scene_config: passed to the scenario's ``make_scene``; None for its default.
        image_size: height and width of observed pictures, pixels.
        render_size: height and width of what `render` returns, pixels.
        render_camera: camera of `render`.
        terminate_on_success: end the episode on success.

    Raises:
        OptionError: an argument has a value that it cannot have.
        DisplayError: ``"human"`` where there is no display.
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

        # Twice the size: pictures for people are rendered large and halved.
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
            seed: the scene's seed. Without one, the scene's seed is drawn from the environment's generator.
            options: ``{"scene": s}`` takes the scene of seed s, or s itself if it is a scene.

        Raises:
            OptionError: another option, or something that is no scene.
            SceneError: a scene that cannot be made.
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
            ActionError: wrong shape, or not finite. Entries out of range are clipped.
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
        """A picture of the present state, or None where a window shows it."""
        if self.render_mode != "rgb_array":
            return None
        return self.picture(self.render_camera, *self.render_size)

    def close(self) -> None:
        """Free the window and what pictures need."""
        self._renderer.close()
        if self._window is not None:
            self._window.close()

    @property
    def compute_reward(self):
        """Reward function (achieved, desired, info) of a goal environment; ``info`` is not used.

        Only observations of type ``state`` have goals, and libraries take an environment with this attribute for a
        goal environment: with others there is no such attribute.
        """
        if self.obs_type != "state":
            raise AttributeError(f"compute_reward needs obs_type='state', this environment has {self.obs_type!r}")
        return self._compute_reward

    def _compute_reward(
        self, achieved_goal: Float[np.ndarray, "*batch 10"], desired_goal: Float[np.ndarray, "*batch 10"], info: object
    ) -> Float[np.ndarray, "*batch"]:
        del info
        return self._reward(np.asarray(achieved_goal), np.asarray(desired_goal), self.scenario.tolerance)

    # For experts, collectors and tests --------------------------------------------------------------------------

    @property
    def world(self) -> World:
        """The physics of the present episode."""
        if self._world is None:
            raise gymnasium.error.ResetNeeded("call reset() first: there is no scene yet")
        return self._world

    @property
    def scene(self) -> Scene:
        """The scene of the present episode."""
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
        """Whether the target counts as placed now: what ``info["is_success"]`` says."""
        return bool(reward.is_success(*self._goals(), self.scenario.tolerance))

    def action_toward(self, command: Float[np.ndarray, " n+1"]) -> Float[np.ndarray, " m"]:
        """The action (float32, within the action space) that comes nearest to a command (n + 1,)."""
        space = self._control.action_space
        action = self._control.toward(command, self._command).astype(np.float32)
        return np.clip(action, space.low, space.high)

    def effort(self, command: Float[np.ndarray, " n+1"]) -> float:
        """How many steps the arm needs at least from the last command to this one (n + 1,)."""
        return self._control.effort(command, self._command)

    @property
    def planner_robot(self) -> Robot:
        """The robot as the planner sees it, from the very model that is simulated (made once)."""
        return _planner_robot(self.scenario)

    def task(self) -> Task:
        """The planner's task from the present state: objects are where they are now."""
        return make_task(self.world)

    def plan(
        self,
        strategy: Strategy | str,
        seed: int = 0,
        options: PlanOptions | None = None,
        known_grasps: Sequence[Grasp] = (),
    ) -> Plan:
        """The planner's plan of the task from the present state: what the expert follows. See `regrasp_planner.plan`.

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
        """How much effort the planner makes in these scenes."""
        from regrasp_planner import PlanOptions

        return PlanOptions()

    def picture(self, camera: str, height: int, width: int) -> UInt8[np.ndarray, "H W 3"]:
        """A picture with smooth edges from any camera of the model, with a translucent target at the goal.

        Raises:
            OptionError: larger than ``render_size``, or the environment has no render mode.
        """
        if not self.render_mode or height > self.render_size[0] or width > self.render_size[1]:
            raise OptionError(
                f"a picture of {height}×{width} pixels is larger than the buffer; make the environment with "
                f"render_mode='rgb_array' and render_size=({height}, {width})"
            )
        world = self.world
        large = self._renderer.render(world.model, world.data, camera, 2 * width, 2 * height, show_goal=True)
        return halved(large)

    def get_state(self) -> EnvState:
        """All that the future of the episode depends on; `set_state` continues from it to the last bit."""
        random = self.np_random.bit_generator.state
        world = self.world
        joints = self.scenario.robot.arm_joints
        return EnvState(joints, world.scene, world.get_state(), self._command.copy(), self._elapsed, random)

    def set_state(self, state: EnvState) -> dict:
        """Go back to a saved state, of this environment or of another one of the same id, and return its observation.

        Raises:
            StateError: not a saved state, or one of another robot or of more objects than observations have room for.
        """
        if not isinstance(state, EnvState):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise StateError(f"{type(state).__name__} is no saved state; give what get_state() returned")
        if state.joints != self.scenario.robot.arm_joints:
            raise StateError(f"the state is of another robot, with the joints {', '.join(state.joints)}")
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

    # Parts ------------------------------------------------------------------------------------------------------

    def _chosen_scene(self, seed: int | None, options: dict[str, Any]) -> Scene:
        unknown = set(options) - {"scene"}
        if unknown:
            raise OptionError(f"unknown reset option {sorted(unknown)[0]!r}; the only one is 'scene'")
        wanted = options.get("scene")
        # Drawn even if it is not used, so that what follows does not depend on the options.
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        if wanted is None:
            return self.scenario.make_scene(drawn, self.scene_config)
        if isinstance(wanted, (int, np.integer)) and not isinstance(wanted, bool):
            return self.scenario.make_scene(int(wanted), self.scene_config)
        if isinstance(wanted, Scene):
            self._check_room(wanted, OptionError)
            return wanted
        raise OptionError(f"option 'scene' is {wanted!r}; give a scene or the seed of one")

    def _check_room(self, scene: Scene, error: type[EnvError]) -> None:
        if len(scene.others) > self.scenario.max_others:
            raise error(
                f"the scene has {len(scene.others)} objects besides the target; observations have room for "
                f"{self.scenario.max_others}"
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
        """Achieved and desired goal. A step works them out once: contacts and poses take time."""
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
