"""Digests of scenes: what a seed means must not change as long as the environment's id stays the same.

Run as a script it writes `scene_digests.json`, which is only right for an id whose version has been raised.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import gymnasium
import numpy as np

import regrasp_gym  # noqa: F401  registers the ids

IDS = tuple(f"regrasp_gym/{name}-v0" for name in ("PandaYCB", "PandaYCBLift", "PandaYCBDirect", "PandaYCBRegrasp"))
IDS += ("regrasp_gym/ExcavatorStones-v0",)
SEEDS = range(51)
FILE = Path(__file__).with_suffix(".json")
DECIMALS = 9
"""Values are rounded, so that processors that round their last bits differently agree."""


def scene_digest(env: gymnasium.Env, seed: int) -> str:
    """Digest of everything a scene is made of: names, poses, fixtures, words, and the masses and sizes simulated."""
    _, info = env.reset(seed=seed)
    scene, model = env.unwrapped.scene, env.unwrapped.world.model
    things = [scene.target, *scene.others]
    words = [info["instruction"], *(thing.name for thing in things), *(fixture.name for fixture in scene.fixtures)]
    numbers = [
        scene.goal_pose,
        *(thing.pose for thing in things),
        *(np.concatenate([fixture.size, fixture.pose]) for fixture in scene.fixtures),
        scene.release.center,
        scene.release.half_extents,
        env.unwrapped.world.data.qpos,
        model.body_mass,
        model.body_inertia.ravel(),
        model.geom_size.ravel(),
    ]
    # Zero has a sign, which means nothing here.
    rounded = np.round(np.concatenate(numbers), DECIMALS) + 0.0
    return hashlib.sha256("\n".join(words).encode() + rounded.tobytes()).hexdigest()[:16]


def digests(env_id: str) -> list[str]:
    """The digest of each of `SEEDS`, in order."""
    env = gymnasium.make(env_id)
    try:
        return [scene_digest(env, seed) for seed in SEEDS]
    finally:
        env.close()


if __name__ == "__main__":
    FILE.write_text(json.dumps({env_id: digests(env_id) for env_id in IDS}, indent=1) + "\n")
