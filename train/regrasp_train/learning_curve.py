"""Learning curves: evaluations during training, their file and their plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

from regrasp_gym.reports.files import read_lines
from regrasp_gym.reports.plots import COLOURS, save_figure
from regrasp_gym.reports.report import wilson

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class CurvePoint:
    """One evaluation during training.

    Attributes:
        steps: environment steps so far.
        seconds: wall-clock time so far, evaluations included.
        episodes: episodes of the evaluation.
        successes: how many of them succeeded.
    """

    steps: int
    seconds: float
    episodes: int
    successes: int


def read_points(path: Path, last_step: int | None = None) -> list[CurvePoint]:
    """Evaluations in a file, up to ``last_step``; none if there is no file. Half-written lines are skipped."""
    points = [CurvePoint(**line) for line in read_lines(path)]
    return [point for point in points if last_step is None or point.steps <= last_step]


def curve_report(points: Sequence[CurvePoint]) -> list[dict[str, Any]]:
    """Evaluations with their success rates and 95 % intervals, for JSON."""
    return [
        {
            **asdict(point),
            "success_rate": point.successes / max(point.episodes, 1),
            "success_rate_95": wilson(point.successes, point.episodes),
        }
        for point in points
    ]


def plot_curves(curves: Mapping[str, Sequence[CurvePoint]], path: Path | None, title: str) -> None:
    """Draw learning curves, with their 95 % intervals, over environment steps; nothing if there is no file.

    Args:
        curves: evaluations by name of the run.
        path: .svg, .png or .pdf.
        title: title of the picture.

    Raises:
        BenchError: another suffix, or matplotlib is not installed.
    """

    def paint(axes: Axes) -> None:
        for colour, (name, points) in zip(cycle(COLOURS), curves.items(), strict=False):
            steps = [point.steps for point in points]
            low, high = zip(*(wilson(point.successes, point.episodes) for point in points), strict=True)
            shares = [100 * point.successes / max(point.episodes, 1) for point in points]
            axes.plot(steps, shares, label=name, color=colour)
            axes.fill_between(steps, [100 * x for x in low], [100 * x for x in high], color=colour, alpha=0.15)
        axes.set(xlabel="environment steps", ylabel="success (%)", ylim=(-2, 102), title=title)
        axes.legend()

    save_figure(path, paint)
