"""Behaviour cloning with LeRobot's trainer, through our command and through LeRobot's own, and its evaluation."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import pytest
from scripted_lift import LIFT, collected

pytest.importorskip("lerobot")
pytest.importorskip("yaml")

from regrasp_gym.seeds import FIRST_SEED
from regrasp_train.bc import TrainBcOptions, flattened, fresh, merged, train
from regrasp_train.errors import MismatchError, RunError
from regrasp_train.evaluate import EvalOptions, evaluate
from regrasp_train.run_folder import lock_run
from regrasp_train.scenes import held_out

pytestmark = pytest.mark.lerobot

SMALL = ["--policy.dim_model=32", "--policy.dim_feedforward=32", "--policy.n_encoder_layers=1", "--num_workers=0"]
OFFLINE = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
PLUGIN = "--env.discover_packages_path=regrasp_datasets.lerobot_env"


def policy_of(run):
    return run / "checkpoints" / "last" / "pretrained_model"


@pytest.fixture(scope="module")
def trained(tmp_path_factory, lifts):
    """A run of four steps from vectors."""
    run = tmp_path_factory.mktemp("bc") / "run"
    train(TrainBcOptions(run, lifts, steps=4, batch_size=4, save_every=2, device="cpu"), SMALL)
    return run


def test_tables_are_merged_and_flattened():
    merged_table = merged({"a": 1, "b": {"c": 2, "d": 3}}, {"b": {"c": 4}})
    assert merged_table == {"a": 1, "b": {"c": 4, "d": 3}}
    assert flattened(merged_table) == ["--a=1", "--b.c=4", "--b.d=3"]
    assert flattened({"policy": {"normalization_mapping": {"ENV": "MEAN_STD"}, "use_vae": False}}) == [
        '--policy.normalization_mapping={"ENV": "MEAN_STD"}',
        "--policy.use_vae=false",
    ]


def test_a_run_goes_on(trained, lifts):
    with pytest.raises(RunError, match="--resume"):
        fresh(TrainBcOptions(trained, lifts))
    assert sorted(path.name for path in (trained / "checkpoints").iterdir()) == ["000002", "000004", "last"]
    saved = json.loads((policy_of(trained) / "train_config.json").read_text())
    assert saved["env"]["task"] == LIFT.removeprefix("regrasp_gym/")
    assert saved["policy"]["normalization_mapping"]["ENV"] == "MEAN_STD"
    train(TrainBcOptions(trained, steps=6, resume=True))
    state = trained / "checkpoints" / "last" / "training_state" / "training_step.json"
    assert json.loads(state.read_text())["step"] == 6


def test_the_policy_is_evaluated(trained, tmp_path):
    summary, records, policy = tmp_path / "eval.json", tmp_path / "eval.jsonl", str(policy_of(trained))
    assert evaluate(EvalOptions(policy, episodes=1, records=records, json_file=summary)) == 0
    found = json.loads(summary.read_text())
    assert found["env"] == LIFT
    assert found["env_kwargs"]["control_mode"] == "ee_delta"
    assert found["by_object"]["061_foam_brick"]["episodes"] == 1
    assert sum(found["reached"].values()) == 1
    assert len(found["success_rate_95"]) == 2
    # The same again costs nothing.
    before = records.read_text()
    assert evaluate(EvalOptions(policy, episodes=1, records=records)) == 0
    assert records.read_text() == before


@pytest.mark.slow
def test_episodes_are_filmed(trained, tmp_path):
    videos, policy = tmp_path / "films", str(policy_of(trained))
    assert evaluate(EvalOptions(policy, episodes=2, records=tmp_path / "e.jsonl", videos=videos, filmed=1)) == 0
    (film,) = videos.iterdir()
    assert film.name == "scene-1000000000.mp4"
    assert film.stat().st_size > 1000


def test_a_checkpoint_of_another_environment_is_refused(trained, tmp_path):
    with pytest.raises(MismatchError, match="was trained with action of shape"):
        evaluate(EvalOptions(str(policy_of(trained)), control_mode="joint_pos", records=tmp_path / "e.jsonl"))
    with pytest.raises(MismatchError, match=r"environment_state of shape .*regrasp_gym/PandaYCB-v0 has"):
        evaluate(EvalOptions(str(policy_of(trained)), env="regrasp_gym/PandaYCB-v0", records=tmp_path / "e.jsonl"))
    with pytest.raises(RunError, match="give its policy"):
        evaluate(EvalOptions(str(trained), records=tmp_path / "e.jsonl"))


def test_more_scenes_than_there_are_is_refused(tmp_path):
    command = EvalOptions("expert", env="regrasp_gym/PandaYCBDirect-v0", episodes=10**6, records=tmp_path / "e.jsonl")
    with pytest.raises(MismatchError, match="or fewer"):
        evaluate(command)


def test_a_dataset_that_does_not_fit_is_refused(lifts, tmp_path):
    run = tmp_path / "run"
    with pytest.raises(MismatchError, match=r"does not fit regrasp_gym/PandaYCB-v0: its observation.environment_state"):
        fresh(TrainBcOptions(run, lifts, env="regrasp_gym/PandaYCB-v0"))
    with pytest.raises(MismatchError, match="holds no images"):
        fresh(TrainBcOptions(run, lifts, config="bc-images"))
    with pytest.raises(RunError, match="--dataset is missing"):
        fresh(TrainBcOptions(run))
    with pytest.raises(RunError, match="no checkpoint"):
        train(TrainBcOptions(run, resume=True))
    run.mkdir()
    with pytest.raises(RunError, match="choose another --run"):
        fresh(TrainBcOptions(run, lifts))
    with lock_run(tmp_path / "other"), pytest.raises(RunError, match="another training is at work"):
        train(TrainBcOptions(tmp_path / "other", lifts, device="cpu"))
    with pytest.raises(RunError, match="'sac' is not one of behaviour cloning"):
        fresh(TrainBcOptions(tmp_path / "new", lifts, config="sac"))


def test_validation_is_in_held_out_scenes(lifts, tmp_path):
    arguments = fresh(TrainBcOptions(tmp_path / "run", lifts, seed=3))
    assert f"--seed={FIRST_SEED['val'] + 3}" in arguments
    assert not any(argument.startswith("--env.split") for argument in arguments)
    of_list = held_out("regrasp_gym/PandaYCBDirect-v0", "val")
    assert of_list == (0, {"split": "val"})


@pytest.mark.slow
def test_a_killed_run_goes_on(lifts, tmp_path):
    run = tmp_path / "run"
    command = [sys.executable, "-m", "regrasp_train.bc", "--run", str(run), "--dataset", str(lifts), "--device", "cpu"]
    command += ["--steps", "100000", "--batch-size", "4", "--save-every", "5", "--", *SMALL]
    process = subprocess.Popen(command, env=OFFLINE)
    deadline = time.monotonic() + 120
    while not (run / "checkpoints" / "000010" / "training_state" / "training_step.json").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.1)
    process.kill()
    process.wait()
    state = run / "checkpoints" / "last" / "training_state" / "training_step.json"
    steps = json.loads(state.read_text())["step"]
    train(TrainBcOptions(run, steps=steps + 2, resume=True))
    assert json.loads(state.read_text())["step"] == steps + 2


@pytest.mark.slow
def test_stock_lerobot_evaluates_in_a_batch(trained, tmp_path):
    """``lerobot-eval`` itself, in a process of its own, as a user would call it."""
    arguments = [f"--policy.path={policy_of(trained)}", PLUGIN, "--env.type=regrasp", "--env.task=PandaYCBLift-v0"]
    arguments += ["--env.obs_type=environment_state_agent_pos", "--env.control_mode=ee_delta"]
    arguments += ["--env.episode_length=5", "--eval.batch_size=2", "--eval.n_episodes=2", "--eval.use_async_envs=false"]
    arguments += [f"--output_dir={tmp_path}", "--policy.device=cpu", "--seed=1000000000"]
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_eval", *arguments]
    subprocess.run(command, check=True, env=OFFLINE, timeout=240)
    info = json.loads((tmp_path / "eval_info.json").read_text())
    assert len(info["overall"]["video_paths"]) == 2
    assert info["overall"]["n_episodes"] == 2


def stock_training(dataset, run, obs_type):
    """``lerobot-train`` itself, with an evaluation, in a process of its own."""
    arguments = [f"--dataset.repo_id=local/{dataset.name}", f"--dataset.root={dataset}", f"--output_dir={run}"]
    arguments += ["--policy.type=act", "--policy.device=cpu", "--policy.push_to_hub=false", "--policy.chunk_size=8"]
    arguments += ["--policy.n_action_steps=8", "--policy.pretrained_backbone_weights=null", "--wandb.enable=false"]
    arguments += ["--steps=2", "--batch_size=2", "--env_eval_freq=2", "--eval.n_episodes=2", "--eval.batch_size=2"]
    arguments += [PLUGIN, "--env.type=regrasp", "--env.task=PandaYCBLift-v0", "--env.control_mode=ee_delta"]
    arguments += [f"--env.obs_type={obs_type}", "--env.image_size=64", "--env.episode_length=4"]
    arguments += ["--eval.use_async_envs=false", *SMALL]
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_train", *arguments]
    subprocess.run(command, check=True, env=OFFLINE, timeout=240)
    assert (policy_of(run) / "model.safetensors").exists()


@pytest.mark.slow
def test_stock_lerobot_trains_from_vectors(lifts, tmp_path):
    stock_training(lifts, tmp_path / "stock", "environment_state_agent_pos")


@pytest.mark.slow
def test_stock_lerobot_trains_from_images(tmp_path):
    """And so do our commands on the same dataset."""
    dataset = collected(tmp_path / "dataset", episodes=1, images=True, image_size=64)
    stock_training(dataset, tmp_path / "stock", "pixels_environment_state_agent_pos")

    ours = tmp_path / "ours"
    train(TrainBcOptions(ours, dataset, config="bc-images", steps=2, batch_size=2, device="cpu"), SMALL)
    inputs = json.loads((policy_of(ours) / "config.json").read_text())["input_features"]
    assert "observation.environment_state" not in inputs
    assert inputs["observation.images.front"]["shape"] == [3, 64, 64]
    command = EvalOptions(str(policy_of(ours)), episodes=1, records=tmp_path / "eval.jsonl", device="cpu")
    assert evaluate(command) == 0
