"""The paper's two scenarios, as environments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import gymnasium

from regrasp_bench.options import PlotOptions
from regrasp_gym.errors import BenchError

Scenario = Literal["panda", "excavator"]
ENVS: dict[Scenario, str] = {"panda": "regrasp_gym/PandaYCB-v0", "excavator": "regrasp_gym/ExcavatorStones-v0"}


@dataclass(frozen=True, kw_only=True)
class ScenarioOptions(PlotOptions):
    """Options of a benchmark on scenes of one of the paper's scenarios."""

    scenario: Scenario = "panda"
    """Robot and objects."""
    trials: int = 300
    """Number of scenes, one per seed."""
    first_seed: int = 0
    """Seed of the first scene."""

    @property
    def seeds(self) -> range:
        """Seeds of the scenes."""
        return range(self.first_seed, self.first_seed + self.trials)

    @property
    def env(self) -> str:
        """Id of the scenario's environment.

        Raises:
            BenchError: it is not registered.
        """
        env = ENVS[self.scenario]
        if env not in gymnasium.registry:
            registered = ", ".join(name for name, known in ENVS.items() if known in gymnasium.registry)
            raise BenchError(
                f"scenario {self.scenario!r} needs the environment {env}, which is missing; use {registered}"
            )
        return env
