"""Non-static releases: whether an object that is released tilted settles in MuJoCo into the predicted pose."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from regrasp_bench.options import PlotOptions
from regrasp_bench.tables.benchmark import Presentation, run_benchmark
from regrasp_bench.tables.drops import SAME_POSE
from regrasp_bench.tables.release_trials import prepare
from regrasp_bench.tables.summary import completed, percent
from regrasp_gym.objects import OBJECTS
from regrasp_gym.reports.plots import OURS, OURS_LIGHT, PAPER
from regrasp_gym.reports.report import Record, wilson
from regrasp_gym.reports.trials import crashes, print_crashes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GROUPS: tuple[str, ...] = (
    "planned",
    "planned, gripper retreating",
    "… no finger in the way",
    "anywhere in the cone",
    "outside of the cone",
    "paper's cone",
)


@dataclass(frozen=True, kw_only=True)
class ReleasesOptions(PlotOptions):
    """Release shipped objects and random stones at rest, 2 mm above a table, and let them settle in MuJoCo.

    Half of the releases are those that GraspGen⁺ plans where the gripper would otherwise hit the ground: once of the
    bare object, and once with the gripper, which opens and retreats. The latter are also counted without those where a
    finger is in the way (`settling_clearance`). The other half are spread evenly over the cones. As a control, the same
    object is also released outside of its cone, tilted to the same side by 1.5 to 2 times the half-angle, and within
    the cone that the paper's alpha shape of 128 starts gives. An interrupted run resumes.
    """

    trials: int = 500
    """Number of releases."""
    first_trial: int = 0
    """Number of the first release."""
    records: Path = Path("outputs/bench/releases.jsonl")


def releases(options: ReleasesOptions) -> int:
    """Run the benchmark; returns the exit code."""
    from regrasp_planner.placement.basins import DROP, ENERGY, MARGIN
    from regrasp_planner.placement.tilted_release import BLOCKED

    rule = {"drop": DROP, "energy": ENERGY, "margin": MARGIN, "blocked": BLOCKED, "blocking": "fingers"}
    setting: Record = {"benchmark": "releases", "version": version("regrasp-gym"), "rule": rule}
    trials = range(options.first_trial, options.first_trial + options.trials)
    return run_benchmark(options, setting, trials, prepare, summarise, Presentation(_show, _paint, 2), "releases")


def summarise(_: Record, done: Sequence[Record]) -> Record:
    """Counts by group and kind of object."""
    ended = completed(done)
    groups = {name: [record["drops"][name] for record in ended if name in record["drops"]] for name in _GROUPS}
    inside = groups["planned"] + groups["anywhere in the cone"]
    rows = {"in the cone": inside, **groups}
    for kind in ("shipped objects", "stones"):
        rows[f"in the cone, {kind}"] = [drop for drop in inside if drop["stone"] == (kind == "stones")]
    angles = np.array([record["half_angles"] for record in ended]).reshape(-1, 2)
    return {
        "trials": len(done),
        "within_degrees": float(np.rad2deg(SAME_POSE)),
        "groups": {name: _count(drops) for name, drops in rows.items()},
        "half_angle_degrees": {
            "mean": float(np.rad2deg(angles[:, 0].mean())) if len(angles) else None,
            "mean of the paper's, same poses": float(np.rad2deg(angles[:, 1].mean())) if len(angles) else None,
        },
        "share_by_tilt": _by_tilt([*inside, *groups["outside of the cone"]]),
        "misses": [
            {"trial": r["trial"], "thing": r["thing"], "group": name, **drop}
            for r in ended
            for name, drop in r["drops"].items()
            if name in _GROUPS[:4] and not drop["settled"]
        ],
        "without_cone": dict(sorted(Counter(name for record in ended for name in record["without_cone"]).items())),
        "crashed": crashes(done),
    }


def _count(drops: Sequence[Record]) -> Record:
    settled = sum(drop["settled"] for drop in drops)
    return {
        "releases": len(drops),
        "settled": settled,
        "share": settled / len(drops) if drops else None,
        "share_95": wilson(settled, len(drops)),
        "tilt_degrees_mean": float(np.rad2deg(np.mean([drop["tilt"] for drop in drops]))) if drops else None,
    }


def _by_tilt(drops: Sequence[Record]) -> list[Record]:
    """Counts by the tilt as a multiple of the half-angle."""
    edges = np.linspace(0, 2, 9)
    place = np.digitize([drop["tilt"] / drop["half_angle"] for drop in drops], edges[1:-1])
    return [
        {
            "multiple": float(0.5 * (edges[k] + edges[k + 1])),
            **_count([d for d, p in zip(drops, place, strict=True) if p == k]),
        }
        for k in range(len(edges) - 1)
    ]


# --- what is shown ----------------------------------------------------------------------------------------------------


def _show(report: Record) -> None:
    console = Console()
    title = (
        f"{report['trials']} releases at rest, 2 mm above the table; settled: within {report['within_degrees']:.0f}°"
    )
    table = Table("released", "releases", "settled as predicted", "% (95 %)", "mean tilt", title=title)
    for name, row in report["groups"].items():
        if row["releases"]:
            share = percent(row["settled"], row["releases"], row["share_95"], 1, 1)
            tilt = f"{row['tilt_degrees_mean']:.0f}°"
            table.add_row(name, str(row["releases"]), str(row["settled"]), share, tilt)
    console.print(table)
    ours, paper = report["half_angle_degrees"].values()
    if ours is not None:
        console.print(
            f"mean half-angle {ours:.1f}°, of the paper's cones of the same poses {paper:.1f}°", highlight=False
        )
    if report["without_cone"]:
        names = [name for name in report["without_cone"] if name in OBJECTS]
        stones = len(report["without_cone"]) - len(names)
        listed = ", ".join([*names, *([f"{stones} stones"] if stones else [])])
        console.print(f"no pose with a cone, so never released non-statically: {listed}", highlight=False)
    print_crashes(report["crashed"], "trials")


def _paint(report: Record, _: Sequence[Record], left: Axes, right: Axes) -> None:
    rows = {name: report["groups"][name] for name in _GROUPS if report["groups"][name]["releases"]}
    shares = [100 * row["share"] for row in rows.values()]
    ends = np.array([[100 * end for end in row["share_95"]] for row in rows.values()]).reshape(-1, 2).T
    colours: dict[str, str] = dict(zip(_GROUPS, (OURS, OURS, OURS, OURS, OURS_LIGHT, PAPER), strict=True))
    names = [f"{name}\n({row['releases']})" for name, row in rows.items()]
    error = np.abs(ends - np.array(shares))
    drawn = left.barh(names, shares, color=[colours[name] for name in rows], xerr=error)
    left.bar_label(drawn, [f" {share:.1f} %" for share in shares], fontsize=7, padding=8)
    left.set_xlim(0, 115)
    left.invert_yaxis()
    left.set_xlabel("settled as predicted (%)")
    bins = [row for row in report["share_by_tilt"] if row["releases"]]
    middles = [row["multiple"] for row in bins]
    spans = np.abs(np.array([row["share_95"] for row in bins]).T - np.array([row["share"] for row in bins]))
    right.errorbar(middles, [100 * row["share"] for row in bins], 100 * spans, marker="o", color=OURS, capsize=2)
    right.axvline(1.0, color=PAPER, linestyle="--")
    right.set_ylim(0, 105)
    right.set_xlabel("tilt as a multiple of the cone's half-angle")
    right.set_ylabel("settled as predicted (%)")
