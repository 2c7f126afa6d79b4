"""Figures in one style. matplotlib (extra ``bench``) is imported only to draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from regrasp_gym.errors import BenchError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.typing import RcKeyType

OURS, OURS_LIGHT, PEER, PEER_LIGHT, PAPER = "#1f6f8b", "#7fb7be", "#d1783f", "#eab98f", "#9a9a9a"
"""Colours of this project and of a peer, each with a lighter one for a second quantity, and of the paper."""
COLOURS = (OURS, PEER, OURS_LIGHT, PEER_LIGHT, PAPER, "#7a5195", "#4a7c3a")
FORMATS = (".svg", ".png", ".pdf")

_STYLE: dict[RcKeyType, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "savefig.dpi": 150,
    # Equal figures give equal files.
    "svg.hashsalt": "regrasp",
}


def save_figure(
    file: Path | None,
    paint: Callable[..., None],
    panels: int = 1,
    size: tuple[float, float] = (5.6, 3.4),
) -> None:
    """Write a figure; nothing if there is no file.

    Args:
        file: .svg, .png or .pdf.
        paint: called with one matplotlib ``Axes`` per panel.
        panels: number of panels, side by side.
        size: width and height of a panel, inches.

    Raises:
        BenchError: another suffix, or matplotlib is not installed.
    """
    if file is None:
        return
    check_format(file)
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise BenchError(f"figures need matplotlib: pip install 'regrasp-gym[bench]' ({error})") from error
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(panels * size[0], size[1]), layout="constrained")
        paint(*figure.subplots(1, panels, squeeze=False)[0])
        file.parent.mkdir(parents=True, exist_ok=True)
        # With the date in it, every file would differ.
        dated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
        figure.savefig(file, metadata=dated.get(file.suffix))


def check_format(file: Path | None) -> None:
    """Check that a figure can be written in the format of ``file``, before the work that it shows.

    Raises:
        BenchError: its suffix is not one of `FORMATS`.
    """
    if file is not None and file.suffix not in FORMATS:
        raise BenchError(f"--plot {file} is not a picture: give a name that ends in {', '.join(FORMATS)}")


def bars(
    axes: Axes,
    groups: Sequence[str],
    series: Mapping[str, Sequence[float | None]],
    colours: Sequence[str] = COLOURS,
    spans: Mapping[str, Sequence[tuple[float, float] | None]] | None = None,
) -> None:
    """Draw bars side by side for each group, with the value over each.

    Args:
        axes: where to draw.
        groups: names under the bars.
        series: one value per group; None draws no bar.
        colours: one per series.
        spans: lower and upper end of the error bars of some series.
    """
    width = 0.8 / len(series)
    at = np.arange(len(groups))
    for i, (name, values) in enumerate(series.items()):
        x = at + (i - 0.5 * (len(series) - 1)) * width
        heights = np.array([np.nan if value is None else value for value in values], float)
        drawn = axes.bar(x, heights, 0.92 * width, label=name, color=colours[i % len(colours)])
        labels = ["" if value is None else f"{value:.4g}" for value in values]
        axes.bar_label(drawn, labels, fontsize=7, padding=2)
        for place, height, span in zip(x, heights, (spans or {}).get(name, ()), strict=False):
            if span is not None:
                error = [[max(height - span[0], 0.0)], [max(span[1] - height, 0.0)]]
                axes.errorbar(place, height, error, fmt="none", ecolor="#333333", elinewidth=0.8, capsize=2)
    axes.set_xticks(at, groups)
    axes.grid(False, axis="x")
    axes.legend()


def cumulative_shares(
    axes: Axes,
    series: Mapping[str, Float[np.ndarray, " N"]],
    label: str,
    colours: Sequence[str] = COLOURS,
) -> None:
    """Draw the share of values up to each value, one curve per series, on a logarithmic axis.

    Args:
        axes: where to draw.
        series: (N,) positive values each; infinite ones keep the curve below 1.
        label: label of the axis, with the unit.
        colours: one per series.
    """
    for i, (name, values) in enumerate(series.items()):
        ordered = np.sort(np.asarray(values, float))
        finite = ordered[np.isfinite(ordered)]
        share = np.arange(1, len(finite) + 1) / max(len(ordered), 1)
        axes.step(finite, share, where="post", label=f"{name} ({len(ordered)})", color=colours[i % len(colours)])
    axes.set_xscale("log")
    # Whole decades; otherwise matplotlib labels the minor ticks, and the labels overlap.
    low, high = axes.get_xlim()
    axes.set_xlim(10 ** np.floor(np.log10(low)), 10 ** np.ceil(np.log10(high)))
    axes.set_ylim(0, 1.02)
    axes.set_xlabel(label)
    axes.set_ylabel("share")
    axes.legend(loc="upper left")
