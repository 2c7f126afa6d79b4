"""How benchmarks run: trials, a summary, and what is shown of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from regrasp_bench.options import BenchOptions, PlotOptions
from regrasp_gym.reports.plots import check_format, save_figure
from regrasp_gym.reports.report import Record, write_report
from regrasp_gym.reports.trials import Prepare, run_trials


@dataclass(frozen=True)
class Presentation:
    """How a summary is published.

    Attributes:
        show: prints it.
        paint: draws it, given the summary, the trials' records and one matplotlib ``Axes`` per panel.
        panels: number of panels.
        packages: those whose versions the JSON report states.
    """

    show: Callable[[Record], None]
    paint: Callable[..., None] | None = None
    panels: int = 1
    packages: Sequence[str] = ("regrasp-gym", "mujoco", "jax", "numpy", "scipy")


def run_benchmark(
    options: BenchOptions,
    setting: Record,
    trials: Sequence[int],
    prepare: Prepare,
    summarise: Callable[[Record, Sequence[Record]], Record],
    presentation: Presentation,
    label: str = "scenes",
) -> int:
    """Run the trials, and publish their summary.

    Args:
        options: those of the command line.
        setting: what the trials have in common.
        trials: their numbers.
        prepare: makes, once per process, the function that runs a trial.
        summarise: makes the summary from the setting and the records. Its ``crashed`` lists the trials that crashed.
        presentation: how the summary is published.
        label: text of the progress bar.

    Returns:
        The exit code: 1 if trials crashed, else 0.
    """
    check_plot(options)
    records = run_trials(setting, trials, prepare, workers=options.workers, records=options.records, label=label)
    summary = summarise(setting, records)
    publish(options, summary, records, presentation)
    return 1 if summary["crashed"] else 0


def check_plot(options: BenchOptions) -> None:
    """Raise `BenchError` before the work if the figure cannot be written."""
    if isinstance(options, PlotOptions):
        check_format(options.plot_file)


def publish(options: BenchOptions, summary: Record, records: Sequence[Record], presentation: Presentation) -> None:
    """Print a summary, and write it as JSON and as a figure where the options ask for it."""
    presentation.show(summary)
    write_report(options.json_file, summary, presentation.packages)
    if isinstance(options, PlotOptions) and presentation.paint is not None:
        save_figure(options.plot_file, partial(presentation.paint, summary, records), presentation.panels)
