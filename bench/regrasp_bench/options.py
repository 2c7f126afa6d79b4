"""Options that benchmarks share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from regrasp_gym.reports.command_line import JsonFile
from regrasp_gym.reports.report import Record


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """Options of every benchmark. An interrupted run resumes from its records."""

    workers: int = 1
    """Processes."""
    records: Path
    """One JSON line per trial, appended as it ends."""
    json_file: JsonFile = None
    """Write the summary as JSON."""

    def values(self, *names: str) -> Record:
        """Values of the named options."""
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, kw_only=True)
class PlotOptions(BenchOptions):
    """Options of a benchmark that draws its summary."""

    plot_file: Annotated[Path | None, tyro.conf.arg(name="plot")] = None
    """Draw the summary (.svg, .png or .pdf)."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions(BenchOptions):
    """Options of a benchmark that times work on an environment's scenes."""

    env: str = "regrasp_gym/PandaYCB-v0"
    """Environment id."""
    scenes: int = 50
    """Number of scenes."""
    first_seed: int = 0
    """Seed of the first scene."""
    workers: int = 1
    """Processes. With more than one, times are not reliable."""

    @property
    def seeds(self) -> range:
        """Seeds of the scenes."""
        return range(self.first_seed, self.first_seed + self.scenes)
