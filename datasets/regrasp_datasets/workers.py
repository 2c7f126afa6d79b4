"""Worker processes that write one episode per seed, and are replaced when they die or take too long."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

import gymnasium as gym

from regrasp_datasets.features import base_env, features_of
from regrasp_datasets.records import Attempt, EpisodeRecord, versions
from regrasp_datasets.rollout import Rollout, RolloutError, RolloutOptions, make_env, make_expert, run_expert
from regrasp_datasets.shards import write_shard
from regrasp_gym.errors import RegraspGymError

STOP_SECONDS = 5.0
"""Seconds that a worker gets to end before it is killed."""


def plan_path(folder: Path, seed: int) -> Path:
    """File of an episode's plan, kept to be drawn."""
    return folder / f"seed-{seed:08d}.pickle"


class WorkerError(RegraspGymError):
    """No worker can run. The message says why."""


@dataclass(frozen=True)
class WorkerOptions:
    """How workers run episodes.

    Attributes:
        rollout: the environment and the expert.
        shards: folder of the episodes.
        logs: folder of the workers' output.
        plans: folder of the plans of saved episodes, or None.
        codec: video codec.
        keep_failures: also save executed episodes that failed.
        timeout: seconds after which an episode's worker is killed.
    """

    rollout: RolloutOptions
    shards: Path
    logs: Path
    plans: Path | None
    codec: str
    keep_failures: bool
    timeout: float


@dataclass(frozen=True)
class _SetUp:
    error: str | None


@dataclass
class _Worker:
    number: int
    process: BaseProcess
    connection: Connection
    ready: bool = False
    seed: int | None = None
    deadline: float = float("inf")


class WorkerPool:
    """Worker processes; a context manager that ends them all.

    Args:
        options: how they run episodes.
        count: number of workers.
    """

    def __init__(self, options: WorkerOptions, count: int) -> None:
        self._options = options
        self._context = multiprocessing.get_context("spawn")
        self._workers: list[_Worker] = []
        self._count = count

    def __enter__(self) -> WorkerPool:
        self._workers = [self._start(number) for number in range(self._count)]
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(STOP_SECONDS)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.connection.close()

    @property
    def idle(self) -> int:
        """Number of workers that wait for a seed."""
        return sum(worker.ready and worker.seed is None for worker in self._workers)

    @property
    def busy_seeds(self) -> set[int]:
        """Seeds that workers are running."""
        return {worker.seed for worker in self._workers if worker.seed is not None}

    def assign(self, seed: int, *, need_regrasp: bool) -> None:
        """Give a seed to an idle worker."""
        worker = next(worker for worker in self._workers if worker.ready and worker.seed is None)
        worker.seed = seed
        worker.deadline = time.monotonic() + self._options.timeout
        # `results` finds a worker that has died since.
        with contextlib.suppress(OSError):
            worker.connection.send((seed, need_regrasp))

    def results(self, timeout: float) -> Iterator[Attempt]:
        """Attempts that have ended. Waits for the first for at most ``timeout`` seconds.

        A worker that died or took too long is replaced; its seed comes back as ``crashed`` or ``timeout``.

        Raises:
            WorkerError: the environment or the expert cannot be set up, or a worker died during set-up.
        """
        wait([worker.connection for worker in self._workers], timeout)
        for index, worker in enumerate(self._workers):
            try:
                message = worker.connection.recv() if worker.connection.poll() else None
            except (EOFError, OSError):
                yield from self._replace(index, "crashed")
                continue
            if isinstance(message, _SetUp):
                if message.error is not None:
                    raise WorkerError(message.error)
                worker.ready = True
            elif isinstance(message, Attempt):
                worker.seed, worker.deadline = None, float("inf")
                yield message
            elif time.monotonic() > worker.deadline:
                yield from self._replace(index, "timeout")

    def _start(self, number: int) -> _Worker:
        here, there = self._context.Pipe()
        process = self._context.Process(
            target=_work, args=(there, self._options, self._options.logs / f"worker-{number}.log"), daemon=True
        )
        # Ctrl-C goes to every process of the terminal, and only the parent reacts. The worker inherits this.
        with _interrupts_ignored():
            process.start()
        there.close()
        return _Worker(number, process, here)

    def _replace(self, index: int, outcome: str) -> Iterator[Attempt]:
        worker = self._workers[index]
        worker.process.kill()
        worker.process.join()
        worker.connection.close()
        log = self._options.logs / f"worker-{worker.number}.log"
        if not worker.ready:
            raise WorkerError(f"A worker died during set-up (exit code {worker.process.exitcode}); see {log}.")
        self._workers[index] = self._start(worker.number)
        if worker.seed is not None:
            reason = (
                f"longer than {self._options.timeout:.0f} s"
                if outcome == "timeout"
                else f"the worker process died (exit code {worker.process.exitcode})"
            )
            yield Attempt(worker.seed, outcome, cause=reason, reason=reason)


@contextlib.contextmanager
def _interrupts_ignored() -> Generator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _work(connection: Connection, options: WorkerOptions, log: Path) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _die_with_parent()
    with log.open("a") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)
    try:
        env = make_env(options.rollout.env_id, options.rollout.env_kwargs)
        features_of(env)
        env.reset(seed=0)
        make_expert(options.rollout, env)
    except (RolloutError, ValueError) as error:
        connection.send(_SetUp(str(error)))
        return
    except Exception as error:
        traceback.print_exc()
        connection.send(_SetUp(f"The environment cannot be set up: {type(error).__name__}: {error}"))
        return
    connection.send(_SetUp(None))
    with contextlib.suppress(EOFError, OSError):
        while True:
            seed, need_regrasp = connection.recv()
            connection.send(_attempt(env, options, seed, need_regrasp))


def _attempt(env: gym.Env, options: WorkerOptions, seed: int, need_regrasp: bool) -> Attempt:
    started = time.perf_counter()
    try:
        result = run_expert(env, options.rollout, seed, need_regrasp=need_regrasp)
        if isinstance(result, Attempt):
            return result
        if not (result.success or options.keep_failures):
            return result.attempt
        write_shard(
            options.shards,
            result,
            _record(options.rollout, result, time.perf_counter() - started),
            features=features_of(env),
            fps=int(env.metadata["render_fps"]),
            robot_type=base_env(env).planner_robot.name,
            codec=options.codec,
        )
        if options.plans is not None:
            plan_path(options.plans, seed).write_bytes(pickle.dumps(result.plan))
        return replace(result.attempt, saved=True)
    except Exception as error:
        # One broken episode must not end a long collection. The traceback is in the log.
        traceback.print_exc()
        return Attempt(seed, "crashed", cause=type(error).__name__, reason=f"{type(error).__name__}: {error}")


def _record(options: RolloutOptions, rollout: Rollout, seconds: float) -> EpisodeRecord:
    attempt = rollout.attempt
    return EpisodeRecord(
        episode_index=0,
        seed=attempt.seed,
        env_id=options.env_id,
        env_kwargs=options.env_kwargs,
        expert=options.expert,
        strategy=options.strategy,
        target=attempt.target,
        task=rollout.task,
        planned_stages=len(rollout.plan.stages),
        stages=attempt.stages,
        frames=attempt.frames,
        success=rollout.success,
        planning_seconds=attempt.planning_seconds,
        seconds=seconds,
        initial_state_sha256=rollout.initial_state_sha256,
        final_state_sha256=rollout.final_state_sha256,
        versions=versions(),
    )


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
