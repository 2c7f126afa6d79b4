"""Reports of commands: figures with the versions and the machine that they were made with."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from regrasp_gym.reports.files import write_json

Record = dict[str, Any]
"""What JSON can hold, by name."""


def write_report(
    json_file: Path | None,
    report: Record,
    packages: Sequence[str] = ("regrasp-gym", "mujoco", "jax", "numpy", "scipy"),
) -> None:
    """Write a report as JSON, with the versions of ``packages`` and the machine; nothing if there is no file."""
    if json_file is not None:
        write_json(json_file, {**report, "versions": package_versions(packages), "machine": machine()})


def package_versions(packages: Sequence[str]) -> dict[str, str]:
    """Versions of installed packages."""
    return {name: version(name) for name in packages}


def machine() -> str:
    """Processor and number of cores of this machine."""
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return f"{name}, {os.cpu_count()} cores"


def wilson(count: int, total: int) -> tuple[float, float]:
    """95 % confidence interval of a share, ``count`` of ``total`` (Wilson 1927); (0, 1) without trials."""
    if total == 0:
        return 0.0, 1.0
    # Takes a second to import, which --help need not.
    from scipy.stats import binomtest

    interval = binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)
