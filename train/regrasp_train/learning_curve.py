"""How well a learner does as it learns: evaluations while training, their file, and its plot."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from regrasp_gym.benchmark.trials import wilson


@dataclass(frozen=True)
class CurvePoint:
    """One evaluation during training.

    Attributes:
        steps: environment steps learnt from so far.
        seconds: wall-clock time learnt so far, evaluations included.
        episodes: episodes of the evaluation.
        successes: how many of them succeeded.
    """

    steps: int
    seconds: float
    episodes: int
    successes: int


def append_point(path: Path, point: CurvePoint) -> None:
    """Add an evaluation to a file of JSON lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as stream:
        stream.write(json.dumps(asdict(point)) + "\n")


def read_points(path: Path, last_step: int | None = None) -> list[CurvePoint]:
    """Evaluations in a file, up to ``last_step``; none if there is no file. Half-written lines are left out."""
    points: list[CurvePoint] = []
    for line in path.read_text().splitlines() if path.exists() else []:
        with contextlib.suppress(json.JSONDecodeError, TypeError):
            points.append(CurvePoint(**json.loads(line)))
    return [point for point in points if last_step is None or point.steps <= last_step]


def rewrite_points(path: Path, points: Sequence[CurvePoint]) -> None:
    """Make a file hold just these evaluations: what a killed run did after its last checkpoint is done again."""
    if not path.exists():
        return
    temporary = path.with_suffix(".tmp")
    temporary.write_text("".join(json.dumps(asdict(point)) + "\n" for point in points))
    temporary.replace(path)


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


def plot_curves(curves: Mapping[str, Sequence[CurvePoint]], path: Path, title: str) -> None:
    """Draw learning curves, with their 95 % intervals, over environment steps.

    Args:
        curves: evaluations by the learner's name.
        path: picture to write; its ending says of what kind.
        title: of the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for name, points in curves.items():
        steps = [point.steps for point in points]
        low, high = zip(*(wilson(point.successes, point.episodes) for point in points), strict=True)
        (line,) = axes.plot(steps, [100 * point.successes / max(point.episodes, 1) for point in points], label=name)
        axes.fill_between(steps, [100 * x for x in low], [100 * x for x in high], color=line.get_color(), alpha=0.15)
    axes.set(xlabel="environment steps", ylabel="success (%)", ylim=(-2, 102), title=title)
    axes.grid(alpha=0.3)
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
