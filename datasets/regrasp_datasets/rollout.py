"""One episode: an environment, an expert, and what happened between them."""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass, field
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from regrasp_datasets.features import FeatureError, Step, base_env, observe
from regrasp_datasets.records import Attempt, state_sha256
from regrasp_gym.errors import RegraspGymError

DEFAULT_EXPERT = "regrasp_gym:PlannerExpert"


class RolloutError(RegraspGymError):
    """An environment or an expert that cannot be set up as asked. The message names what and why."""


class Expert(Protocol):
    """What a collector asks of an expert; it is constructed as ``Expert(env, strategy=…, seed=…)``.

    Attributes:
        failure: why it gave up, or None.
        stage_index: stage that the action returned last belongs to.
        plan: the first plan, with ``stages``; None before one is found.
    """

    failure: Any
    stage_index: int
    plan: Any

    def reset(self) -> bool:
        """Plan from the environment's current state; whether a plan was found."""
        ...

    def act(self, obs: Any) -> np.ndarray | None:
        """The next action, or None when it has finished or given up."""
        ...


@dataclass(frozen=True)
class RolloutOptions:
    """Who acts where.

    Attributes:
        env_id: Gymnasium id.
        env_kwargs: keyword arguments of ``gym.make``.
        expert: ``module:name`` of the expert's class.
        strategy: handed to the expert.
    """

    env_id: str
    env_kwargs: dict[str, Any] = field(default_factory=dict)
    expert: str = DEFAULT_EXPERT
    strategy: str = "repeated"


@dataclass(frozen=True)
class Rollout:
    """An executed episode.

    Attributes:
        steps: one per step of the environment.
        attempt: what became of it.
        task: the task in words.
        plan: the expert's first plan.
        initial_state_sha256: digest of the physics state after the reset.
        final_state_sha256: digest of the physics state after the last step.
    """

    steps: list[Step]
    attempt: Attempt
    task: str
    plan: Any
    initial_state_sha256: str
    final_state_sha256: str

    @property
    def success(self) -> bool:
        """Whether the task counts as solved after the last step."""
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


def make_expert(config: RolloutOptions, env: gym.Env) -> Expert:
    """Construct the expert of ``config`` for ``env``.

    A new one per episode: whatever it drew or learnt in one episode must not reach the next, or an episode would
    depend on which worker ran it.

    Raises:
        RolloutError: there is no such class, or no such strategy.
    """
    from regrasp_planner.stages.plan import Strategy

    names = [str(member) for member in Strategy]
    if config.strategy not in names:
        raise RolloutError(f"Unknown strategy {config.strategy!r}; the strategies are {', '.join(names)}.")
    module_name, _, name = config.expert.partition(":")
    try:
        make = getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise RolloutError(f"Expert {config.expert!r} (module:name) cannot be imported: {error}") from error
    return make(env, strategy=config.strategy, seed=0)


def run_expert(env: gym.Env, config: RolloutOptions, seed: int, *, need_regrasp: bool = False) -> Rollout | Attempt:
    """Reset ``env`` with ``seed`` and let the expert act until it or the environment ends the episode.

    Args:
        env: made by `make_env`.
        config: who acts.
        seed: handed to ``env.reset``.
        need_regrasp: give up at once if the plan needs no regrasp.

    Returns:
        A Rollout if at least one step was executed, otherwise the attempt with its reason.
    """
    obs, _ = env.reset(seed=seed)
    scene = base_env(env).scene
    target, task = scene.target.name, scene.instruction
    initial_state = digest_of(env)
    expert = make_expert(config, env)

    started = time.perf_counter()
    planned = expert.reset()
    thought = time.perf_counter() - started
    planned_stages = len(expert.plan.stages) if planned else 0
    if not planned:
        return _attempt(seed, "plan failed", target, thought, failure=expert.failure)
    if need_regrasp and planned_stages < 2:
        return _attempt(seed, "not needed", target, thought, stages=planned_stages)

    space = env.action_space
    assert isinstance(space, gym.spaces.Box)
    steps: list[Step] = []
    while True:
        started = time.perf_counter()
        action = expert.act(obs)
        thought += time.perf_counter() - started
        if action is None:
            break
        # What is stored is float32 and within bounds, and what is stored has to be what was stepped.
        action = np.clip(np.asarray(action, dtype=np.float32), space.low, space.high)
        shown, stage_index = observe(env, obs), expert.stage_index
        obs, reward, terminated, truncated, info = env.step(action)
        steps.append(Step(shown, action, stage_index, float(reward), bool(info["is_success"]), bool(truncated)))
        if terminated or truncated:
            break

    failure: Any = None
    if not steps or not steps[-1].success:
        failure = expert.failure or ("time limit" if steps and steps[-1].truncated else "target not at its goal")
    outcome = "success" if failure is None else "execution failed"
    stages = 1 + max((step.stage_index for step in steps), default=-1)
    attempt = _attempt(seed, outcome, target, thought, failure=failure, stages=stages, frames=len(steps))
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
    """Digest of the physics state and of the controller's command, in double precision."""
    state = base_env(env).get_state()
    return state_sha256(state.physics, state.command)


def _attempt(
    seed: int, outcome: str, target: str, thought: float, *, failure: Any = None, stages: int = 0, frames: int = 0
) -> Attempt:
    if failure is None:
        cause = reason = ""
    elif hasattr(failure, "constraint"):
        # A planner's Failure: its message may hold figures of this very scene, its reason does not.
        cause, reason = f"{failure.reason} in {failure.stage}" if failure.stage else str(failure.reason), str(failure)
    else:
        cause = reason = str(failure)
    return Attempt(
        seed,
        outcome,
        cause=cause,
        reason=reason,
        target=target,
        stages=stages,
        planning_seconds=thought,
        frames=frames,
    )
