"""The Panda's task by difficulty, as certified by the planner: one grasp suffices, or a regrasp is needed."""

from __future__ import annotations

from typing import Any

from regrasp_gym.envs.panda_ycb import PandaYCBEnv
from regrasp_gym.errors import OptionError
from regrasp_gym.scenes.scene import Scene
from regrasp_gym.seeds import SPLITS, read_seeds


class _CertifiedEnv(PandaYCBEnv):
    """`PandaYCBEnv` on the scenes of a shipped list."""

    seed_list: str

    def __init__(self, split: str = "train", **arguments: Any) -> None:
        if split not in SPLITS:
            raise OptionError(f"split={split!r} is unknown; choose one of {', '.join(map(repr, SPLITS))}")
        if "scene_config" in arguments:
            raise OptionError("scene_config cannot be given: the list of scenes is for the default; use PandaYCB-v0")
        super().__init__(**arguments)
        self.split = split
        self.scene_seeds = read_seeds(self.seed_list)[split]

    def _chosen_scene(self, seed: int | None, options: dict[str, Any]) -> Scene:
        # Drawn even if an option names the scene, so that later scenes do not depend on the options.
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        listed = self.scene_seeds[drawn % len(self.scene_seeds)]
        return super()._chosen_scene(listed, options)


class PandaYCBDirectEnv(_CertifiedEnv):
    """The scenes of `PandaYCBEnv` in which one grasp suffices.

    Only the meaning of seeds differs. ``reset(seed=k)`` takes scene k of a shipped list, modulo its length: k from 0 to
    ``len(env.unwrapped.scene_seeds) - 1`` gives different scenes. ``info["scene_seed"]`` is the seed of the same scene
    in `PandaYCBEnv`. ``reset(options={"scene": s})`` takes the scene of that seed, listed or not.

    In a listed scene the planner finds a plan with a single grasp, and its execution in the simulation succeeds.
    `regrasp-certify` makes the list.

    Args:
        split: ``"train"``, ``"val"`` or ``"test"``; no scene is in two of them.
        **arguments: as for `PandaYCBEnv`, except ``scene_config``: the list is for the default.

    ## Version History

    * v0: first version.
    """

    seed_list = "panda_ycb_direct"


class PandaYCBRegraspEnv(_CertifiedEnv):
    """The scenes of `PandaYCBEnv` in which the planner needs a regrasp.

    As `PandaYCBDirectEnv`, with another list. In a listed scene the planner finds no plan with a single grasp. It finds
    one with at least one regrasp, and its execution in the simulation succeeds. (In about 3 % of the scenes where an
    exhaustive search finds a single grasp, the planner misses it: `regrasp-bench difficulty --direct`.)

    Args:
        split: ``"train"``, ``"val"`` or ``"test"``; no scene is in two of them.
        **arguments: as for `PandaYCBEnv`, except ``scene_config``: the list is for the default.

    ## Version History

    * v0: first version.
    """

    seed_list = "panda_ycb_regrasp"
