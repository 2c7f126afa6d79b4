from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from waves import SCENARIOS, options, quiet

from regrasp_datasets.collect import collect


@pytest.fixture(scope="session")
def dataset(tmp_path_factory) -> Path:
    """Four episodes of the Panda; three have a regrasp."""
    pytest.importorskip("lerobot")
    root = tmp_path_factory.mktemp("collected") / "waves"
    assert collect(options(root, json_file=root.with_suffix(".json")), quiet()) == 0
    return root


@pytest.fixture(scope="session", params=SCENARIOS)
def robot(request) -> str:
    """The robot of each scenario in turn."""
    return request.param


@pytest.fixture(scope="session")
def each_dataset(robot, request, tmp_path_factory) -> Path:
    """A dataset of each scenario in turn; all but the Panda's as small as possible."""
    pytest.importorskip("lerobot")
    if robot == "panda":
        return request.getfixturevalue("dataset")
    root = tmp_path_factory.mktemp("collected") / robot
    changes = {"env": SCENARIOS[robot][0], "episodes": 2, "require_regrasp": 0, "workers": 1}
    assert collect(options(root, **changes), quiet()) == 0
    return root


@pytest.fixture
def copied(dataset, tmp_path) -> Path:
    """A copy of the dataset, to be changed."""
    return Path(shutil.copytree(dataset, tmp_path / "copied"))
