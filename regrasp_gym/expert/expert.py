"""The planner as an expert that acts through an environment's own action space."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np
from jaxtyping import Float

from regrasp_gym.envs.base import RegraspEnv
from regrasp_gym.errors import OptionError
from regrasp_gym.simulation.world import World
from regrasp_planner import Failure, Grasp, Plan, PlanOptions, Reason, Segment, SegmentKind, Stage, Strategy

Command = Float[np.ndarray, " n+1"]
Script = Generator[Command, None, Failure | None]


@dataclass(frozen=True)
class ExpertOptions:
    """Options of `PlannerExpert`.

    Times are seconds on a table-top; they grow with the scenario's `pace`.

    Attributes:
        max_stages: stages executed before the expert gives up.
        arrival_time: longest wait for the arm to arrive at the end of a motion.
        grip_time: least and most time to close the fingers.
        open_time: time to open the fingers.
        rest_time: longest wait for the released target to come to rest.
        calm_time: time for which the target has to rest.
        grip_rate: rate below which the fingers count as standing still, in their range per second.
        lost_travel: how much further than planned the fingers may close before the grasp counts as lost, as a share
            of their range.
        retries: new plans after lost grasps.
    """

    max_stages: int = 6
    arrival_time: float = 0.6
    grip_time: tuple[float, float] = (0.3, 0.8)
    open_time: float = 0.3
    rest_time: float = 3.0
    calm_time: float = 0.3
    grip_rate: float = 0.025
    lost_travel: float = 0.1
    retries: int = 2


class PlannerExpert:
    """Plans from the environment's present state, executes one stage, and plans again from where the target rests.

    ``reset`` plans. ``act`` gives the next action, or None at the end; ``failure`` then says why the expert gave up,
    and is None if the target is at its goal.

    Args:
        env: an environment of this package, wrapped or not.
        strategy: see `regrasp_planner.Strategy`.
        seed: seed of the planner.
        plan_options: options of the planner; by default those of the environment.
        options: see `ExpertOptions`.

    Attributes:
        plan: the first plan of the episode.
        plans: all plans made in the episode, in order.
        failure: why the expert gave up; None while it has not.
        stage_index: number of stages executed so far.
        segment: the segment being executed; None before the first and after the last action.

    Raises:
        OptionError: the environment is not one of this package.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        strategy: Strategy | str = Strategy.REPEATED,
        seed: int = 0,
        plan_options: PlanOptions | None = None,
        options: ExpertOptions | None = None,
    ) -> None:
        inner = env.unwrapped
        if not isinstance(inner, RegraspEnv):
            raise OptionError(f"PlannerExpert needs an environment of regrasp_gym, got {type(inner).__name__}")
        self.env: RegraspEnv = inner
        self.strategy, self.seed = strategy, seed
        self.plan_options, self.options = plan_options, options or ExpertOptions()
        self.plans: list[Plan] = []
        self.failure: Failure | None = None
        self.stage_index = 0
        self.segment: Segment | None = None
        self._script: Script | None = None
        self._world: World | None = None

    @property
    def plan(self) -> Plan:
        """The first plan of the episode."""
        if not self.plans:
            raise OptionError("there is no plan yet: call reset() first")
        return self.plans[0]

    def reset(self) -> bool:
        """Plan from the environment's present state; False if there is no plan (see ``failure``)."""
        self.failure, self.stage_index, self.segment, self._script, self.plans = None, 0, None, None, []
        self._world = self.env.world
        self.plans = [self._plan()]
        self.failure = self.plan.failure
        self._script = self._episode() if self.plan.success else None
        return self.plan.success

    def act(self, observation: object = None) -> Float[np.ndarray, " m"] | None:
        """The next action (float32, in the environment's action space), or None when there is nothing more to do.

        The expert reads the environment's state. The observation is ignored; it keeps the usual calling convention.
        """
        del observation
        if self._script is None:
            return None
        if self.env.world is not self._world:
            raise OptionError("the environment was reset since the plan was made: call the expert's reset() too")
        try:
            command = next(self._script)
        except StopIteration as end:
            self.failure, self._script, self.segment = end.value, None, None
            return None
        return self.env.action_toward(command)

    # --- the episode as a recipe --------------------------------------------------------------------------------------

    def _episode(self) -> Script:
        """Execute a stage and plan again, until the target is at its goal."""
        current, lost = self.plan, 0
        while True:
            stage = current.stages[0]
            held = yield from self._execute(stage)
            if held:
                yield from self._until_rest()
                self.stage_index += 1
                if self.env.is_success:
                    return None
                if len(current.stages) == 1:
                    return self._failed(Reason.MISPLACED, stage, "pose at rest", "the target came to rest off its goal")
            else:
                lost += 1
                yield from self._open()
                yield from self._until_rest()
                if self.env.is_success:
                    return None
                if lost > self.options.retries:
                    return self._failed(Reason.LOST_GRASP, stage, "friction", "the target is not between the fingers")
            if self.stage_index >= self.options.max_stages:
                return self._failed(Reason.SETTLED_ELSEWHERE, stage, "stages", "too many stages without success")
            ahead = current.stages[1:] if held else current.stages
            current = self._plan(tuple(next_stage.grasp for next_stage in ahead[:1]))
            self.plans.append(current)
            if current.failure is not None:
                reason = Reason.SETTLED_ELSEWHERE if held else Reason.LOST_GRASP
                message = f"no plan from where the target came to rest: {current.failure}"
                return self._failed(reason, stage, current.failure.constraint, message)

    def _execute(self, stage: Stage) -> Generator[Command, None, bool]:
        """Execute the segments of a stage; False as soon as the target is lost."""
        for segment in stage.segments:
            self.segment = segment
            if segment.trajectory is not None:
                yield from self._follow(segment)
            elif segment.kind is SegmentKind.CLOSE:
                yield from self._close(segment.theta)
            else:
                yield from self._open(segment.theta)
            if segment.holding and not self._holds(stage):
                return False
        return True

    # --- motions ------------------------------------------------------------------------------------------------------

    def _follow(self, segment: Segment) -> Generator[Command, None, None]:
        """Follow the trajectory as fast as the action space allows, then wait until the arm has arrived."""
        trajectory = segment.trajectory
        assert trajectory is not None
        period = self.env.scenario.control_period
        t = 0.0
        while t < trajectory.duration:
            pace = self.env.effort(np.append(trajectory.at(min(t + period, trajectory.duration)), segment.theta))
            t = min(t + period / max(1.0, pace), trajectory.duration)
            yield np.append(trajectory.at(t), segment.theta)
        end = np.append(trajectory.goal, segment.theta)
        for _ in range(self._steps(self.options.arrival_time)):
            if self.env.effort(end) < 0.05 and self._arrived():
                return
            yield end

    def _close(self, theta: float) -> Generator[Command, None, None]:
        """Close the fingers until they stand still."""
        least, most = map(self._steps, self.options.grip_time)
        low, high = self.env.scenario.robot.theta_range
        for step in range(most):
            if step >= least and abs(self.env.world.theta_rate) < self.options.grip_rate * (high - low):
                return
            yield self._standing(theta)

    def _open(self, theta: float | None = None) -> Generator[Command, None, None]:
        """Open the fingers."""
        theta = self.env.scenario.robot.theta_range[1] if theta is None else theta
        for _ in range(self._steps(self.options.open_time)):
            yield self._standing(theta)

    def _until_rest(self) -> Generator[Command, None, None]:
        """Wait until the target rests or is at its goal."""
        calm = 0
        for _ in range(self._steps(self.options.rest_time)):
            calm = calm + 1 if self._resting() else 0
            if self.env.is_success or calm >= self._steps(self.options.calm_time):
                return
            yield self.env.command

    def _steps(self, seconds: float) -> int:
        """Environment steps in a time at the scenario's pace."""
        scenario = self.env.scenario
        return round(seconds * scenario.pace / scenario.control_period)

    # --- what the expert sees -----------------------------------------------------------------------------------------

    def _standing(self, theta: float) -> Command:
        return np.append(self.env.command[:-1], theta)

    def _arrived(self) -> bool:
        return bool(np.abs(self.env.world.joint_positions - self.env.command[:-1]).max() < self.env.scenario.arrival)

    def _resting(self) -> bool:
        """Whether the target is well below the speeds allowed at the goal."""
        velocity, tolerance = self.env.world.target_velocity, self.env.scenario.tolerance
        slow = np.linalg.norm(velocity[:3]) < 0.5 * tolerance.speed
        return bool(slow and np.linalg.norm(velocity[3:]) < 0.25 * tolerance.turn_rate)

    def _holds(self, stage: Stage) -> bool:
        """Whether the target keeps the fingers apart and touches them."""
        low, high = self.env.scenario.robot.theta_range
        world = self.env.world
        apart = world.theta > stage.grasp.theta - self.options.lost_travel * (high - low)
        return bool(apart and world.target_contacts()[0])

    def _plan(self, known_grasps: Sequence[Grasp] = ()) -> Plan:
        return self.env.plan(self.strategy, self.seed, self.plan_options, known_grasps)

    @staticmethod
    def _failed(reason: Reason, stage: Stage, constraint: str, message: str) -> Failure:
        return Failure(reason, stage.kind, constraint, message)
