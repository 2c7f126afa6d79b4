"""The Panda's task sorted by difficulty, as the planner finds it: one grasp suffices, or a regrasp is needed."""

from __future__ import annotations

from typing import Any

from regrasp_gym.envs.panda_ycb import PandaYCBEnv
from regrasp_gym.errors import OptionError
from regrasp_gym.scenes.scene import Scene
from regrasp_gym.seeds import SPLITS, read_seeds


class _CertifiedEnv(PandaYCBEnv):
    """`PandaYCBEnv`, restricted to the scenes of a shipped list."""

    seed_list: str

    def __init__(self, split: str = "train", **arguments: Any) -> None:
        if split not in SPLITS:
            raise OptionError(f"split={split!r} is unknown; choose one of {', '.join(map(repr, SPLITS))}")
        if "scene_config" in arguments:
            raise OptionError("scene_config cannot be given: the list of scenes holds for the default one")
        super().__init__(**arguments)
        self.split = split
        self.scene_seeds = read_seeds(self.seed_list)[split]

    def _chosen_scene(self, seed: int | None, options: dict[str, Any]) -> Scene:
        # Drawn even where an option names the scene, so that what follows does not depend on the options.
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        listed = self.scene_seeds[drawn % len(self.scene_seeds)]
        return super()._chosen_scene(listed, options)


class PandaYCBDirectEnv(_CertifiedEnv):
    """The scenes of `PandaYCBEnv` in which one grasp suffices.

    All is as documented there, except the meaning of seeds: ``reset(seed=k)`` takes the k-th scene of a list that is
    shipped with the package, and begins again at its start (so give k from 0 to ``len(env.unwrapped.scene_seeds) - 1``
    for different scenes). ``info["scene_seed"]`` is the seed under which `PandaYCBEnv` has the same scene, and
    ``reset(options={"scene": s})`` means that seed, listed or not.

    In a listed scene the planner finds a way with a single grasp, and its execution in the simulation succeeds.
    `regrasp-certify` makes the list.

    Args:
        split: ``"train"``, ``"val"`` or ``"test"``; no scene is in two of them.
        **arguments: as for `PandaYCBEnv`, except ``scene_config``: the list holds for the default one.

    ## Version History

    * v0: first version.
    """

    seed_list = "panda_ycb_direct"


class PandaYCBRegraspEnv(_CertifiedEnv):
    """The scenes of `PandaYCBEnv` in which the planner finds no single grasp that suffices, but a way with regrasps.

    As `PandaYCBDirectEnv`, with another list: in a listed scene the planner finds no way with a single grasp, it finds
    one with at least one regrasp, and its execution in the simulation succeeds. (The planner misses a single grasp in
    about 3 % of the scenes that an exhaustive search finds one in: `regrasp-bench difficulty --direct`.)

    Args:
        split: ``"train"``, ``"val"`` or ``"test"``; no scene is in two of them.
        **arguments: as for `PandaYCBEnv`, except ``scene_config``: the list holds for the default one.

    ## Version History

    * v0: first version.
    """

    seed_list = "panda_ycb_regrasp"
