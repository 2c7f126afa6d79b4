"""Scenes to learn from, and held-out scenes."""

from __future__ import annotations

from typing import Any

from regrasp_gym.seeds import FIRST_SEED


def held_out(env_id: str, split: str) -> tuple[int, dict[str, Any]]:
    """First seed of a split of an environment's scenes, and the arguments for ``gym.make`` that select it."""
    if env_id.startswith(("regrasp_gym/PandaYCBDirect-", "regrasp_gym/PandaYCBRegrasp-")):
        return 0, {"split": split}
    return FIRST_SEED[split], {}
