"""The picture of the architecture shows the imports as they are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import regrasp_gym
from regrasp_bench.pictures.architecture import PACKAGES, architecture_svg, wings

ROOT = Path(regrasp_gym.__file__).parents[1]
IDS = re.compile(r'id="(regrasp_[^"]+)"')


@pytest.mark.parametrize("package", PACKAGES)
def test_the_picture_in_the_docs_has_the_wings_and_arrows_of_the_code(package: str) -> None:
    drawn = IDS.findall((ROOT / "docs/figures/architecture.svg").read_text().replace("&gt;", ">"))
    graph = wings(package)
    expected = {*graph.nodes, *(f"{start}->{end}" for start, end in graph.edges)}
    found = {name for name in drawn if name.split(".")[0] == package}
    assert found == expected, "run regrasp-bench pictures architecture"


def test_a_picture_is_the_same_each_time() -> None:
    assert architecture_svg() == architecture_svg()


def test_the_planner_has_fewer_than_60_arrows_between_its_wings() -> None:
    assert wings("regrasp_planner").number_of_edges() < 60
