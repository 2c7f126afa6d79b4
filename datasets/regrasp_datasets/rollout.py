"""Episodes: the environment, the expert, and a run of one in the other."""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
import numpy as np

from regrasp_datasets.features import FeatureError, Step, base_env, observe
from regrasp_datasets.records import Attempt, state_sha256
from regrasp_gym.errors import RegraspGymError

if TYPE_CHECKING:
    from regrasp_planner.stages.plan import Failure, Plan

DEFAULT_EXPERT = "regrasp_gym:PlannerExpert"


class RolloutError(RegraspGymError):
    """An environment or an expert cannot be set up. The message says why."""


class Expert(Protocol):
    """Interface of an expert, constructed as ``Expert(env, strategy=…, seed=…)``.

    Attributes:
        failure: why it gave up, or None.
        stage_index: stage of the last action.
        plan: the first plan, or None before one is found.
    """

    failure: Failure | str | None
    stage_index: int
    plan: Plan | None

    def reset(self) -> bool:
        """Plan from the environment's current state. Returns whether a plan was found."""
        ...

    def act(self, obs: dict[str, Any]) -> np.ndarray | None:
        """The next action, or None once it has finished or given up."""
        ...


@dataclass(frozen=True)
class RolloutOptions:
    """The environment and the expert of an episode.

    Attributes:
        env_id: Gymnasium id.
        env_kwargs: keyword arguments of ``gym.make``.
        expert: ``module:name`` of the expert's class.
        strategy: the expert's strategy.
    """

    env_id: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    expert: str = DEFAULT_EXPERT
    strategy: str = "repeated"


@dataclass(frozen=True)
class Rollout:
    """An executed episode.

    Attributes:
        steps: steps of the environment.
        attempt: the outcome.
        task: the task in words.
        plan: the expert's first plan.
        initial_state_sha256: digest of the physics state after the reset.
        final_state_sha256: digest of the physics state after the last step.
    """

    steps: list[Step]
    attempt: Attempt
    task: str
    plan: Plan
    initial_state_sha256: str
    final_state_sha256: str

    @property
    def success(self) -> bool:
        """Whether the task is solved after the last step."""
        return self.steps[-1].success


def make_env(env_id: str, env_kwargs: dict[str, Any]) -> gym.Env:
    """Make an environment of this project.

    Raises:
        RolloutError: the id or an argument is unknown.
    """
    importlib.import_module("regrasp_gym")  # registers the ids
    try:
        env = gym.make(env_id, disable_env_checker=True, **env_kwargs)
    except gym.error.Error as error:
        known = sorted(name for name in gym.registry if name.startswith("regrasp_gym/"))
        raise RolloutError(f"Environment {env_id!r} cannot be made: {error} Known here: {', '.join(known)}.") from error
    except (TypeError, ValueError) as error:
        raise RolloutError(f"Environment {env_id!r} cannot be made with {env_kwargs}: {error}") from error
    try:
        base_env(env)
    except FeatureError as error:
        raise RolloutError(str(error)) from error
    return env


def make_expert(options: RolloutOptions, env: gym.Env) -> Expert:
    """Construct an expert for ``env``.

    Each episode needs a new one. Otherwise its state would make an episode depend on the worker that runs it.

    Raises:
        RolloutError: the class or the strategy is unknown.
    """
    from regrasp_planner.stages.plan import Strategy

    names = [str(member) for member in Strategy]
    if options.strategy not in names:
        raise RolloutError(f"Unknown strategy {options.strategy!r}; the strategies are {', '.join(names)}.")
    module_name, _, name = options.expert.partition(":")
    try:
        make = getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise RolloutError(f"Expert {options.expert!r} (module:name) cannot be imported: {error}") from error
    return make(env, strategy=options.strategy, seed=0)


def run_expert(env: gym.Env, options: RolloutOptions, seed: int, *, need_regrasp: bool = False) -> Rollout | Attempt:
    """Reset ``env`` and let the expert act until it or the environment ends the episode.

    Args:
        env: made by `make_env`.
        options: the expert.
        seed: seed of the reset.
        need_regrasp: do not execute a plan without a regrasp.

    Returns:
        A Rollout if at least one step was executed, else the attempt.
    """
    obs, _ = env.reset(seed=seed)
    scene = base_env(env).scene
    target, task = scene.target.name, scene.instruction
    initial_state = digest_of(env)
    expert = make_expert(options, env)

    started = time.perf_counter()
    found = expert.reset()
    attempt = Attempt(seed, "not needed", target=target, planning_seconds=time.perf_counter() - started)
    if not found:
        return _failed(attempt, "plan failed", expert.failure)
    assert expert.plan is not None
    if need_regrasp and len(expert.plan.stages) < 2:
        return replace(attempt, stages=len(expert.plan.stages))

    space = env.action_space
    assert isinstance(space, gym.spaces.Box)
    steps: list[Step] = []
    planning_seconds = attempt.planning_seconds
    while True:
        started = time.perf_counter()
        action = expert.act(obs)
        planning_seconds += time.perf_counter() - started
        if action is None:
            break
        # The dataset stores float32 within bounds, so the environment gets exactly that.
        action = np.clip(np.asarray(action, dtype=np.float32), space.low, space.high)
        shown, stage_index = observe(env, obs), expert.stage_index
        obs, reward, terminated, truncated, info = env.step(action)
        steps.append(Step(shown, action, stage_index, float(reward), bool(info["is_success"]), bool(truncated)))
        if terminated or truncated:
            break

    attempt = replace(
        attempt,
        outcome="success",
        stages=1 + max((step.stage_index for step in steps), default=-1),
        planning_seconds=planning_seconds,
        frames=len(steps),
    )
    if not steps or not steps[-1].success:
        limit = "time limit" if steps and steps[-1].truncated else "target not at its goal"
        attempt = _failed(attempt, "execution failed", expert.failure or limit)
    if not steps:
        return attempt
    return Rollout(
        steps=steps,
        attempt=attempt,
        task=task,
        plan=expert.plan,
        initial_state_sha256=initial_state,
        final_state_sha256=digest_of(env),
    )


def digest_of(env: gym.Env) -> str:
    """Digest of the physics state and the controller's command, in double precision."""
    state = base_env(env).get_state()
    return state_sha256(state.physics, state.command)


def _failed(attempt: Attempt, outcome: str, failure: Failure | str | None) -> Attempt:
    if failure is None or isinstance(failure, str):
        return replace(attempt, outcome=outcome, cause=failure or "", reason=failure or "")
    # A planner's message may hold figures of this scene; reason and stage do not.
    cause = f"{failure.reason} in {failure.stage}" if failure.stage else str(failure.reason)
    return replace(attempt, outcome=outcome, cause=cause, reason=str(failure))
