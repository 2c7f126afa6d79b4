"""Environments and experts of an episode."""

from __future__ import annotations

import pytest

pytest.importorskip("lerobot")


from regrasp_datasets.rollout import RolloutError, make_env

pytestmark = pytest.mark.lerobot


def test_environments_of_others_are_refused():
    with pytest.raises(RolloutError, match="not an environment of regrasp_gym"):
        make_env("CartPole-v1", {})
