"""The folder of a collection: what is resumed from it, and what is refused."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest

from regrasp_datasets.records import Attempt
from regrasp_datasets.workspace import Workspace, WorkspaceError

SETTINGS = {"strategy": "repeated"}


def test_log_lines_that_cannot_be_used_are_skipped(tmp_path):
    """Half-written, with unknown fields, with missing fields: those seeds are tried again."""
    root = tmp_path / "data"
    with Workspace(root, SETTINGS, resume=False) as workspace:
        workspace.add(Attempt(3, "plan failed"))
    unknown = {**asdict(Attempt(4, "plan failed")), "colour": "red"}
    lines = [json.dumps(unknown), json.dumps({"outcome": "plan failed"}), "{}", '{"seed": 5, "outc']
    with (workspace.folder / "attempts.jsonl").open("a") as log:
        log.write("\n".join(lines))
    with Workspace(root, SETTINGS, resume=True) as workspace:
        assert workspace.attempts == {3: Attempt(3, "plan failed")}


def test_crashes_and_timeouts_are_tried_again(tmp_path):
    with Workspace(tmp_path / "data", SETTINGS, resume=False) as workspace:
        for seed, outcome in enumerate(("crashed", "timeout", "plan failed")):
            workspace.add(Attempt(seed, outcome))
    with Workspace(tmp_path / "data", SETTINGS, resume=True) as workspace:
        assert list(workspace.attempts) == [2]


def test_an_unfinished_collection_is_not_overwritten(tmp_path):
    with Workspace(tmp_path / "data", SETTINGS, resume=False) as workspace:
        workspace.add(Attempt(0, "plan failed"))
    with pytest.raises(WorkspaceError, match="unfinished collection"):
        Workspace(tmp_path / "data", SETTINGS, resume=False)


def test_two_collections_do_not_share_a_folder(tmp_path):
    with (
        Workspace(tmp_path / "data", SETTINGS, resume=False),
        pytest.raises(WorkspaceError, match="Another regrasp-collect"),
    ):
        Workspace(tmp_path / "data", SETTINGS, resume=True)
