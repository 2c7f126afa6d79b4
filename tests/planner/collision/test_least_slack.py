import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_planner.collision.least_slack import least_slack


class Table:
    """Values with lower bounds, and a count of those looked at."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.values = rng.normal(size=(rng.integers(1, 20), rng.integers(1, 30)))
        self.bounds = self.values - rng.exponential(0.3, self.values.shape)
        self.measured = 0

    def measure(self, rows, columns):
        self.measured += len(rows)
        return self.values[rows, columns]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-1.0, 1.0))
def test_the_smallest_value_of_each_row_is_found(seed, cap):
    table = Table(seed)
    value, column = least_slack(table.bounds, table.measure, cap, floor=-np.inf)
    np.testing.assert_array_equal(value, np.minimum(table.values.min(axis=1), cap))
    below = value < cap
    np.testing.assert_array_equal(column[below], table.values.argmin(axis=1)[below])
    assert (column[~below] == -1).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rows_below_the_floor_are_settled_by_their_first_value(seed):
    table, every = Table(seed), Table(seed)
    value, _ = least_slack(table.bounds, table.measure)
    least_slack(every.bounds, every.measure, floor=-np.inf)
    np.testing.assert_array_equal(value < 0, (table.values < 0).any(axis=1))
    assert table.measured <= every.measured <= table.values.size


@pytest.mark.parametrize("shape", [(0, 4), (3, 0)])
def test_without_entries_the_cap_is_the_answer(shape):
    value, column = least_slack(np.zeros(shape), lambda rows, columns: np.zeros(len(rows)), 0.2)
    np.testing.assert_array_equal(value, np.full(shape[0], 0.2))
    np.testing.assert_array_equal(column, np.full(shape[0], -1))
