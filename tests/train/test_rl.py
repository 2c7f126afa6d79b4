"""Reinforcement learning: environments, demonstrations in the replay buffer, a run, its resumption and evaluation."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from scripted_lift import LIFT

pytest.importorskip("stable_baselines3")
pytest.importorskip("tensorboard")

from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv

from regrasp_gym.errors import BenchError
from regrasp_train.demonstrations import (
    DemonstrationReplayBuffer,
    check_demonstrations,
    demonstration_buffer,
    read_demonstrations,
)
from regrasp_train.errors import MismatchError, RunError
from regrasp_train.evaluate import EvalOptions, evaluate
from regrasp_train.goal_features import GoalFeatures, NormalizedReLU
from regrasp_train.learning_curve import read_points
from regrasp_train.rl import TrainRlOptions, train
from regrasp_train.rl_envs import make_eval_env, make_learning_env, make_learning_envs
from regrasp_train.rl_models import restored
from regrasp_train.run_folder import PROGRESS, checkpoints_in, lock_run, read_run

pytestmark = pytest.mark.rl

KWARGS = {"control_mode": "ee_delta", "reward_type": "sparse"}

TINY = """
default:
  n_envs: {n_envs}
  n_timesteps: 400
  env_kwargs: {{control_mode: ee_delta, reward_type: {reward}}}
  policy: MultiInputPolicy
  batch_size: 32
  policy_kwargs: {{net_arch: [32, 32]}}
"""
SAC = TINY + "  buffer_size: 2000\n  learning_starts: 160\n  gradient_steps: 1\n  train_freq: 8\n"
PPO = TINY + "  n_steps: 64\n  n_epochs: 1\n"


@pytest.fixture
def sac(tmp_path):
    file = tmp_path / "sac.yml"
    file.write_text(SAC.format(n_envs=1, reward="sparse"))
    return str(file)


def options(tmp_path, config, **changes):
    quick = {"steps": 320, "save_every": 160, "eval_every": 160, "eval_episodes": 1, "progress": False, "device": "cpu"}
    return TrainRlOptions(run=tmp_path / "run", config=config, **quick | changes)


@pytest.mark.filterwarnings("ignore")
def test_learning_environment_is_one_for_stable_baselines():
    env = make_learning_env(LIFT, KWARGS)
    check_env(env)
    observation, _ = env.reset(seed=1)
    assert {value.dtype for value in observation.values()} == {np.dtype("float32")}
    env.close()


def test_judging_goes_through_the_validation_scenes_in_turn():
    env = make_eval_env(LIFT, KWARGS, 2)
    seeds = [env.reset()[1]["scene_seed"] for _ in range(3)]
    assert seeds == [500_000_000, 500_000_001, 500_000_000]
    env.close()


@pytest.mark.parametrize("env_id", [LIFT, "regrasp_gym/ExcavatorStones-v0"])
def test_features_say_where_the_target_is(env_id):
    import torch

    env = make_learning_env(env_id, KWARGS)
    observation, _ = env.reset(seed=1)
    features = GoalFeatures(env.observation_space, joints=len(env.unwrapped.scenario.robot.arm_joints))
    batch = {key: torch.as_tensor(value)[None] for key, value in observation.items()}
    out = features(batch)[0].numpy()
    assert out.shape == (features.features_dim,)
    world = env.unwrapped.world
    np.testing.assert_allclose(out[-6:-3], 10 * (world.target_pose[4:] - world.gripper_pose[4:]), atol=1e-4)
    to_goal = 10 * (env.unwrapped.scene.goal_pose[4:] - world.target_pose[4:])
    np.testing.assert_allclose(out[-3:], to_goal, atol=1e-4)
    if env_id == LIFT:
        assert np.abs(out).max() < 5
    env.close()


def test_the_activation_bounds_what_a_network_can_say_far_from_its_data():
    import torch

    inputs = torch.randn(5, 16)
    out = NormalizedReLU()(inputs)
    deviation = inputs.std(dim=1, correction=0, keepdim=True)
    torch.testing.assert_close(
        out, torch.relu((inputs - inputs.mean(dim=1, keepdim=True)) / deviation), atol=1e-4, rtol=0
    )
    torch.testing.assert_close(NormalizedReLU()(1000 * inputs), out, atol=1e-4, rtol=0)


@pytest.mark.lerobot
def test_demonstrations_are_exact_and_a_share_of_each_batch(lifts):
    check_demonstrations(lifts, LIFT, "ee_delta")
    env = make_learning_env(LIFT, KWARGS)
    episodes = read_demonstrations(lifts, env)
    assert len(episodes) == 3
    for episode in episodes:
        rewards = [reward for *_, reward, _ in episode]
        assert rewards[-1] == 0
        assert set(rewards[:20]) == {-1}
        assert [last for *_, last in episode] == [False] * (len(episode) - 1) + [True]
        for before, after in itertools.pairwise(episode):
            np.testing.assert_array_equal(before[1]["observation"], after[0]["observation"])

    vector = DummyVecEnv([lambda: make_learning_env(LIFT, KWARGS)])
    buffer = DemonstrationReplayBuffer(500, env.observation_space, env.action_space, vector, demo_share=0.25)
    buffer.demos = demonstration_buffer(episodes, buffer, vector)
    # Nothing of its own yet: all of the batch is demonstrations.
    batch = buffer.sample(64)
    assert batch.actions.shape == (64, 7)
    assert float(batch.dones.max()) == 0
    # An episode of its own in which nothing moves, told from demonstrations by its actions.
    observation, _ = env.reset(seed=9)
    one = {key: value[None] for key, value in observation.items()}
    for k in range(10):
        buffer.add(one, one, np.full((1, 7), 0.123, np.float32), np.array([-1.0]), np.array([k == 9]), [{}])
    actions = buffer.sample(64).actions.numpy()
    assert (np.abs(actions - 0.123) < 1e-6).all(axis=1).sum() == 48
    vector.close()
    env.close()


@pytest.mark.lerobot
def test_demonstrations_of_another_kind_are_refused(tmp_path, sac, lifts):
    with pytest.raises(MismatchError, match=r"with 'ee_delta'.*--control-mode joint_pos"):
        check_demonstrations(lifts, LIFT, "joint_pos")
    with pytest.raises(MismatchError, match="does not fit regrasp_gym/PandaYCB-v0"):
        train(options(tmp_path, sac, demos=lifts, env="regrasp_gym/PandaYCB-v0"))
    assert not (tmp_path / "run").exists()
    with pytest.raises(RunError, match="--algo ppo"):
        train(options(tmp_path, None, demos=lifts, algo="ppo"))


def test_a_run_goes_on_and_is_evaluated(tmp_path, sac):
    run = tmp_path / "run"
    train(options(tmp_path, sac))
    assert [path.name for path in checkpoints_in(run)] == ["000000000", "000000160", "000000320"]
    assert [path.parent.name for path in run.glob("checkpoints/*/replay_buffer.pkl")] == ["000000320"]
    with pytest.raises(RunError, match="--resume"):
        train(options(tmp_path, sac))
    report, plot = tmp_path / "curve.json", tmp_path / "curve.png"
    train(options(tmp_path, sac, steps=480, resume=True, json_file=report, plot=plot))
    points = read_points(run / "curve.jsonl")
    assert [point.steps for point in points] == [160, 320, 480]
    assert [point.seconds for point in points] == sorted(point.seconds for point in points)
    (curve,) = json.loads(report.read_text())["curves"].values()
    assert len(curve) == 3
    assert plot.exists()
    assert list(run.glob("tensorboard*/events*"))

    summary = tmp_path / "eval.json"
    command = EvalOptions(str(run / "model.zip"), episodes=1, records=tmp_path / "eval.jsonl", json_file=summary)
    assert evaluate(command) == 0
    found = json.loads(summary.read_text())
    assert found["env"] == LIFT
    assert found["episodes"] == 1
    assert found["seeds"] == [1_000_000_000, 1_000_000_000]
    with pytest.raises(MismatchError, match="was trained with the observation space"):
        evaluate(EvalOptions(str(run / "model.zip"), env="regrasp_gym/PandaYCB-v0", records=tmp_path / "e.jsonl"))


def test_nothing_to_go_on_from(tmp_path, sac):
    with pytest.raises(RunError, match="no checkpoint"):
        train(TrainRlOptions(run=tmp_path / "nowhere", resume=True))
    (tmp_path / "run").mkdir()
    with pytest.raises(RunError, match="choose another --run"):
        train(options(tmp_path, sac))


def test_two_trainings_do_not_share_a_folder(tmp_path, sac):
    with lock_run(tmp_path / "run"), pytest.raises(RunError, match="another training is at work"):
        train(options(tmp_path, sac))
    assert not (tmp_path / "run").exists()


def test_a_run_that_goes_on_keeps_what_it_was_told(tmp_path, sac):
    """Its steps, its best model, and no scene twice."""
    run = tmp_path / "run"
    train(options(tmp_path, sac, steps=160))
    train(options(tmp_path, sac, steps=320, resume=True, save_every=None, eval_every=None, eval_episodes=None))
    told = read_run(run)
    assert (told["n_timesteps"], told["save_every"], told["eval_episodes"]) == (320, 160, 1)
    assert (run / "best" / "best_model.zip").exists()
    last = checkpoints_in(run)[-1] / PROGRESS
    progress = json.loads(last.read_text())
    assert progress["best"] == -150
    # Better than an untrained model ever does: what it learns now is no new best one.
    last.write_text(json.dumps({**progress, "best": -10.0}))
    before = (run / "best" / "best_model.zip").stat().st_mtime_ns
    again = TrainRlOptions(run=run, steps=480, resume=True, progress=False, device="cpu")
    train(again)
    assert (run / "best" / "best_model.zip").stat().st_mtime_ns == before
    assert read_points(run / "curve.jsonl")[-1].steps == 480


def test_a_run_that_goes_on_sees_other_scenes(tmp_path, sac):
    train(options(tmp_path, sac, steps=160))
    settings = read_run(tmp_path / "run")
    seen = []
    for steps in (160, 161):
        last = checkpoints_in(tmp_path / "run")[-1] / PROGRESS
        last.write_text(json.dumps({**json.loads(last.read_text()), "steps": steps}))
        envs = make_learning_envs(settings)
        restored(settings, envs, TrainRlOptions(run=tmp_path / "run", device="cpu"))
        envs.reset()
        seen.append(envs.envs[0].unwrapped.scene.seed)
        envs.close()
    assert len({settings["seed"], *seen}) == 3


def test_runs_to_compare_with_are_checked_first(tmp_path, sac):
    with pytest.raises(RunError, match="no learning curve"):
        train(options(tmp_path, sac, compare=(tmp_path / "other",)))
    with pytest.raises(BenchError, match=r"\.svg"):
        train(options(tmp_path, sac, plot=tmp_path / "curve.txt"))
    assert not (tmp_path / "run").exists()


def test_an_episode_is_over_before_learning_starts(tmp_path):
    file = tmp_path / "sac.yml"
    file.write_text(SAC.format(n_envs=2, reward="sparse"))
    train(options(tmp_path, str(file), steps=400, eval_every=10**6))
    assert checkpoints_in(tmp_path / "run")[-1].name == "000000400"


def test_ppo_learns_in_several_environments(tmp_path):
    file = tmp_path / "ppo.yml"
    file.write_text(PPO.format(n_envs=2, reward="dense"))
    train(options(tmp_path, str(file), algo="ppo", steps=256, eval_every=128))
    assert (tmp_path / "run" / "model.zip").exists()


@pytest.mark.slow
@pytest.mark.lerobot
def test_a_killed_run_goes_on(tmp_path, sac, lifts):
    run = tmp_path / "run"
    arguments = [sys.executable, "-m", "regrasp_train.rl", "--run", str(run), "--config", sac, "--no-progress"]
    arguments += ["--device", "cpu", "--save-every", "160", "--eval-every", "100000", "--demos", str(lifts)]
    process = subprocess.Popen([*arguments, "--steps", "1000000"])
    deadline = time.monotonic() + 120
    while len(checkpoints_in(run)) < 3:
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.2)
    process.send_signal(signal.SIGKILL)
    process.wait()
    steps = int(checkpoints_in(run)[-1].name)
    train(options(tmp_path, sac, steps=steps + 80, eval_every=10**6, resume=True))
    assert checkpoints_in(run)[-1].name == f"{steps + 80:09d}"
