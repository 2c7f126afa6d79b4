"""The dataset card."""

from __future__ import annotations

import pytest

pytest.importorskip("lerobot")


from regrasp_datasets.features import STATE

pytestmark = pytest.mark.lerobot


def test_card_counts_what_is_there(dataset):
    card = (dataset / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0")
    assert "| episodes | 4 |" in card
    assert "| of them with a regrasp | 3 |" in card
    assert "| plan failed: no grasp found | 1 |" in card
    assert f"`{STATE}`" in card
