"""The information of a match without the noise."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapmend.igo.observed import cut_down


@given(st.integers(0, 10_000), st.floats(0.0, 1.0), st.floats(1e-3, 1e3))
def test_the_weak_axis_knows_a_share_and_no_direction_falls_below_nothing(seed, share, lever_m):
    # Rows of one point each: (normal, lever times normal), far from the robot, so that heading and place go together.
    rows = np.random.default_rng(seed).normal(size=(4, 3)) * [1.0, 1.0, lever_m]
    normal = rows.T @ rows
    values, vectors = np.linalg.eigh(normal[:2, :2])
    weakest, strong = vectors[:, 0], vectors[:, 1]
    cut = cut_down(normal, weakest, share)
    slack = 1e-9 * np.abs(normal).max()
    assert np.linalg.eigvalsh(cut).min() >= -slack
    np.testing.assert_allclose(weakest @ cut[:2, :2] @ weakest, share * values[0], atol=slack)
    np.testing.assert_allclose(strong @ cut[:2, :2] @ strong, values[1], atol=slack)
    np.testing.assert_allclose(cut[2, 2], normal[2, 2])
