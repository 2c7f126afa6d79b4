"""The wings of each package and the imports between them, read from the code."""

from __future__ import annotations

from io import BytesIO

import grimp
import matplotlib
import networkx as nx
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

PACKAGES = ("regrasp_train", "regrasp_bench", "regrasp_datasets", "regrasp_gym", "regrasp_planner")
"""Top layer first: each imports only from those after it, and nothing imports `regrasp_bench`."""

COLOURS = {
    "regrasp_train": "#f2d7d5",
    "regrasp_bench": "#fdebd0",
    "regrasp_datasets": "#fcf3cf",
    "regrasp_gym": "#d5f5e3",
    "regrasp_planner": "#d6eaf8",
}

_WIDTH, _HEIGHT = 1.5, 0.42
_STEP, _ROW, _GAP = 2.05, 0.62, 0.5


def wings(package: str) -> nx.DiGraph:
    """Wings of a package (its direct subpackages and modules) and which imports which, without implied arrows.

    Arrows that follow from others are left out: if a imports b and b imports c, nothing says so of a and c.

    Raises:
        ValueError: wings import one another in a circle; the message names it.
    """
    graph = grimp.build_graph(package, exclude_type_checking_imports=True)
    children = sorted(graph.find_children(package))
    inside = {module: child for child in children for module in (child, *graph.find_descendants(child))}
    arrows = nx.DiGraph()
    arrows.add_nodes_from(children)
    for module, child in inside.items():
        imported = graph.find_modules_directly_imported_by(module)
        arrows.add_edges_from((child, inside[name]) for name in imported if name in inside and inside[name] != child)
    if not nx.is_directed_acyclic_graph(arrows):
        circle = " → ".join(str(start) for start, _ in nx.find_cycle(arrows))
        raise ValueError(f"{package}: wings import one another in a circle: {circle}")
    return nx.transitive_reduction(arrows)


def architecture_svg() -> str:
    """The wings of all packages as an SVG picture, which names each box and arrow in its ``id``s.

    Within a band, wings import to the right; each band imports from those below.
    """
    bands = [(package, wings(package)) for package in PACKAGES]
    columns = {package: [sorted(column) for column in nx.topological_generations(graph)] for package, graph in bands}
    width = max(map(len, columns.values())) * _STEP + 0.4
    heights = {package: max(map(len, column)) * _ROW + 0.75 for package, column in columns.items()}
    total = sum(heights.values()) + _GAP * (len(bands) - 1)
    with matplotlib.rc_context({"svg.hashsalt": "regrasp", "svg.fonttype": "none", "font.family": "sans-serif"}):
        figure = Figure(figsize=(width * 0.62, total * 0.62))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_xlim(0, width)
        axes.set_ylim(0, total)
        axes.axis("off")
        top = total
        for package, graph in bands:
            _band(axes, package, graph, columns[package], top, heights[package], width)
            top -= heights[package] + _GAP
        written = BytesIO()
        figure.savefig(written, format="svg", metadata={"Date": None})
    return written.getvalue().decode()


def _band(
    axes: Axes, package: str, graph: nx.DiGraph, columns: list[list[str]], top: float, height: float, width: float
) -> None:
    frame = FancyBboxPatch(
        (0.1, top - height),
        width - 0.2,
        height,
        boxstyle="round,pad=0,rounding_size=0.12",
        fc=COLOURS[package],
        ec="none",
    )
    axes.add_patch(frame)
    axes.text(0.25, top - 0.3, package, fontsize=11, fontweight="bold", va="center")
    middle = top - 0.5 - (height - 0.6) / 2
    places: dict[str, tuple[float, float]] = {}
    for k, column in enumerate(columns):
        for i, name in enumerate(column):
            places[name] = (0.3 + k * _STEP, middle + ((len(column) - 1) / 2 - i) * _ROW)
    for start, end in sorted(graph.edges):
        (x0, y0), (x1, y1) = places[start], places[end]
        arrow = FancyArrowPatch(
            (x0 + _WIDTH, y0),
            (x1, y1),
            arrowstyle="-|>",
            mutation_scale=9,
            lw=0.8,
            color="#566573",
            connectionstyle=f"arc3,rad={0.0 if x1 - x0 < 1.5 * _STEP else 0.12}",
            shrinkA=0,
            shrinkB=0,
        )
        arrow.set_gid(f"{start}->{end}")
        axes.add_patch(arrow)
    for name, (x, y) in places.items():
        box = FancyBboxPatch(
            (x, y - _HEIGHT / 2),
            _WIDTH,
            _HEIGHT,
            boxstyle="round,pad=0,rounding_size=0.08",
            fc="white",
            ec="#566573",
            lw=0.8,
        )
        box.set_gid(name)
        axes.add_patch(box)
        axes.text(x + _WIDTH / 2, y, name.removeprefix(package + "."), fontsize=8.5, ha="center", va="center")
