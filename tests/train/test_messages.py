"""What goes wrong is said in one clear message."""

from __future__ import annotations

import importlib.util
import sys

import pytest

from regrasp_train.configs import CONFIGS, read_config
from regrasp_train.errors import RunError

COMMANDS = ("bc", "rl", "evaluate")


def test_shipped_configs_are_tables():
    pytest.importorskip("yaml")
    names = {file.stem for file in CONFIGS.glob("*.yml")}
    assert {"bc-state", "bc-images", "sac", "ppo"} <= names
    for name in names:
        assert read_config(name)


def test_unknown_config_is_named(tmp_path):
    pytest.importorskip("yaml")
    with pytest.raises(RunError, match=r"'nonsense'.*one of: .*bc-state"):
        read_config("nonsense")
    broken = tmp_path / "broken.yml"
    broken.write_text("a: [1")
    with pytest.raises(RunError, match="not valid YAML"):
        read_config(str(broken))
    broken.write_text("- a\n")
    with pytest.raises(RunError, match="no table"):
        read_config(str(broken))


@pytest.mark.parametrize(
    ("module", "arguments", "extra"),
    [
        ("bc", ["--run", "run", "--dataset", "data"], "lerobot"),
        ("rl", ["--run", "run"], "rl"),
    ],
)
def test_commands_say_which_extra_is_missing(monkeypatch, capsys, module, arguments, extra):
    """As on a machine that has the core alone: the commands start, and end with one line."""
    command = importlib.import_module(f"regrasp_train.{module}")
    monkeypatch.setattr(sys, "argv", ["regrasp", *arguments])
    missing = {"lerobot", "stable_baselines3"}
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name in missing else found(name, *rest)
    )
    assert command.main() == 2
    error = capsys.readouterr().err
    assert f"regrasp-gym[{extra}]" in error
    assert "Traceback" not in error


def test_no_policy_is_named(monkeypatch, capsys, tmp_path):
    from regrasp_train import evaluate

    monkeypatch.setattr(sys, "argv", ["regrasp-eval", "--policy", str(tmp_path)])
    assert evaluate.main() == 2
    assert "is no policy" in capsys.readouterr().err
    model = tmp_path / "model.zip"
    model.write_bytes(b"")
    monkeypatch.setattr(sys, "argv", ["regrasp-eval", "--policy", str(model)])
    assert evaluate.main() == 2
    assert "belongs to no run" in capsys.readouterr().err


def test_core_modules_need_no_extra():
    """Importing the commands loads neither torch nor LeRobot nor Stable-Baselines3: --help is quick."""
    import subprocess

    heavy = "torch", "lerobot", "stable_baselines3", "jax"
    imports = "; ".join(f"import regrasp_train.{name}" for name in COMMANDS)
    code = f"import sys; {imports}; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
