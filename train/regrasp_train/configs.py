"""Shipped hyper-parameters, and files like them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from regrasp_train.errors import RunError

_HERE = Path(__file__).resolve().parent
# Beside the package in a clone, inside it in a wheel.
CONFIGS = _HERE / "configs" if (_HERE / "configs").is_dir() else _HERE.parent / "configs"
"""Folder of the shipped YAML files."""


def read_config(config: str) -> dict[str, Any]:
    """Read a YAML file of hyper-parameters.

    Args:
        config: name of a shipped file without its suffix, or path of another.

    Raises:
        RunError: there is no such file, or it holds no table.
    """
    import yaml

    path = Path(config)
    if path.suffix not in (".yml", ".yaml"):
        path = CONFIGS / f"{config}.yml"
    try:
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        shipped = ", ".join(sorted(file.stem for file in CONFIGS.glob("*.yml")))
        raise RunError(f"config {config!r} cannot be read ({error}); give a YAML file or one of: {shipped}") from error
    except yaml.YAMLError as error:
        raise RunError(f"config {path} is not valid YAML: {error}") from error
    if not isinstance(content, dict):
        raise RunError(f"config {path} holds no table of hyper-parameters")
    return content
