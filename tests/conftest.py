from __future__ import annotations

import pytest
from scenario_facts import SCENARIOS, Facts


@pytest.fixture(scope="session", params=SCENARIOS, ids=lambda facts: facts.name)
def facts(request: pytest.FixtureRequest) -> Facts:
    """Each scenario in turn."""
    return request.param
