"""Where the search looks: the grid, the steps it halves, the values measured over all pairs, the valleys to check."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.tuning import search
from mapmend.tuning.search import finalists, grid_roots, steps_to_halve, valleys


def curve(*values):
    return {float(k): v for k, v in enumerate(values)}


def test_the_grid_is_finer_near_0():
    roots = grid_roots()
    steps = np.diff(roots)
    assert roots[0] == 0.0
    assert roots[-1] == search.LARGEST_ROOT
    assert 1.0 in roots
    assert np.all(steps > 0.0)
    assert steps[0] == pytest.approx(steps[-1] / search.FINE_STEPS)


def test_steps_beside_the_least_are_halved_and_those_that_are_low():
    # The least is at 3. Between 5 and 6 M is low too; between 7 and 8 as well, but the same: one map.
    sums_m = curve(9.0, 5.0, 2.0, 1.0, 3.0, 1.015, 3.0, 1.01, 1.011, 3.0)
    assert steps_to_halve(sums_m, 0.1) == [2.5, 3.5, 4.5, 5.5, 6.5, 8.5]
    assert steps_to_halve(sums_m, 1.0) == []


def test_where_all_maps_are_one_only_the_least_is_looked_at_from_both_sides():
    assert steps_to_halve(curve(*[1.0] * 9), 0.1) == [7.5]
    assert steps_to_halve(curve(*[1.0] * 4, 0.9999, *[1.0] * 4), 0.1) == [3.5, 4.5]
    assert steps_to_halve(curve(0.0, 0.0), 0.1) == [0.5]


def test_no_more_steps_are_halved_than_may_be_the_lowest_first():
    rough = curve(*(1.0 + 0.02 * (k % 2) * (1.0 - k / 100.0) for k in range(50)))
    chosen = steps_to_halve(rough, 0.1)
    assert len(chosen) == search.MOST_HALVED
    assert chosen == sorted(chosen)


def narrow_minimum(root, at):
    """A smooth curve with a valley of a hundredth of the range's width, another valley, and a rough floor."""
    rough = 0.003 * np.sin(900.0 * root)
    return 2.0 - np.exp(-(((root - at) / 0.04) ** 2)) - 0.98 * np.exp(-(((root - 3.0) / 0.3) ** 2)) + rough


@given(st.floats(0.15, 2.3))
@settings(max_examples=50, deadline=None)
def test_halving_ends_within_a_hundredth_of_a_dense_sweep(at):
    looked = {r: narrow_minimum(r, at) for r in [k / 64 for k in range(257)]}
    step = search.LARGEST_ROOT / search.GRID_STEPS
    for _ in range(search.ROUNDS):
        looked |= {r: narrow_minimum(r, at) for r in steps_to_halve(looked, step / 2**search.ROUNDS)}
    assert min(looked.values()) <= 1.01 * narrow_minimum(np.linspace(0.0, 4.0, 400), at).min()


def test_finalists_are_the_lowest_and_of_one_map_the_one_that_trusts_the_loops_most():
    assert finalists(curve(1.0, 1.00001, 1.004, 1.02, 1.003, 1.005)) == [1.0, 4.0, 2.0]
    assert finalists(curve(1.0, 1.0, 5.0)) == [1.0]
    assert finalists({0.0: 0.0}) == [0.0]


def test_valleys_are_the_curves_minima_that_are_deep_enough():
    sums_m = curve(5.0, 2.0, 3.0, 1.0, 1.001, 1.0005, 4.0, 1.5)
    assert valleys(sums_m, 3.0) == [3.0, 7.0, 1.0]
    # Values in the same valley are not checked again, although they are a little lower in the sample.
    assert valleys(sums_m, 5.0) == [5.0, 7.0, 1.0]
    assert valleys(curve(1.0, 1.0, 1.0), 2.0) == [2.0]
    # The map of the plateau at the end is checked too, before a valley that is higher.
    assert valleys(curve(5.0, 4.0, 4.5, 1.0, 3.0, 3.0, 3.0), 3.0) == [3.0, 6.0, 1.0]
    assert valleys(curve(5.0, 1.0, 1.00005, 1.00005), 1.0) == [1.0]
    assert valleys({0.0: 0.0}, 0.0) == [0.0]
