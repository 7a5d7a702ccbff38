"""The formulas of the kernels, by their own derivatives and duals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mapmend.errors import MapmendError
from mapmend.graph.robust import (
    KERNELS,
    DynamicCovarianceScaling,
    GemanMcClure,
    MaxMixture,
    Switchable,
    TruncatedQuadratic,
    distrusted,
    kernel_of,
)

PHI = 2.5
ALL = [*(kernel_of(name, PHI) for name in KERNELS), *(TruncatedQuadratic(PHI, mu) for mu in (1e-6, 0.1, 3.0, 1e3))]


def values_off_the_kinks(kernel):
    """chi2 over ten orders of magnitude, slightly away from values where a weight may jump."""
    chi2 = np.geomspace(1e-4, 1e6, 500)
    edges = [PHI]
    if isinstance(kernel, TruncatedQuadratic) and math.isfinite(kernel.mu):
        edges = [PHI * kernel.mu / (kernel.mu + 1.0), PHI * (kernel.mu + 1.0) / kernel.mu]
    return chi2[np.all([np.abs(chi2 / edge - 1.0) > 1e-4 for edge in edges], axis=0)]


@pytest.mark.parametrize("kernel", ALL, ids=str)
def test_the_weight_is_the_derivative_of_the_cost(kernel):
    chi2 = values_off_the_kinks(kernel)
    step = 1e-5 * chi2
    slope = (kernel.cost(chi2 + step) - kernel.cost(chi2 - step)) / (2.0 * step)
    # Costs are bounded or nearly so; their difference is known to some 1e-16 of them.
    rounding = 1e-15 * np.abs(kernel.cost(chi2)) / step
    np.testing.assert_allclose(slope, kernel.weight(chi2), rtol=1e-6, atol=10.0 * rounding.max() * 1e-3 + 1e-9)


@pytest.mark.parametrize("kernel", ALL, ids=str)
def test_costs_begin_at_nothing_rise_and_have_no_steps(kernel):
    chi2 = np.concatenate(([0.0], np.geomspace(1e-6, 1e8, 20_001)))
    cost, weight = kernel.cost(chi2), kernel.weight(chi2)
    assert cost[0] == 0.0
    assert np.all(np.diff(cost) >= -1e-9 * cost[1:])
    assert np.all(np.diff(cost) <= np.diff(chi2) * (1.0 + 1e-9) + 1e-9)
    assert np.all((weight >= 0.0) & (weight <= 1.0))
    assert np.all(np.diff(weight) <= 1e-12)


def test_dcs_is_the_scale_of_its_paper():
    chi2 = np.geomspace(1e-3, 1e6, 200)
    scale = np.minimum(1.0, 2.0 * PHI / (PHI + chi2))
    kernel = DynamicCovarianceScaling(PHI)
    np.testing.assert_allclose(kernel.weight(chi2), scale**2, rtol=1e-14)
    # Its cost is the least over the scale: no other scale in [0, 1] is cheaper.
    others = np.linspace(0.0, 1.0, 2001)[:, None]
    cheapest = np.min(others**2 * chi2 + PHI * (1.0 - others) * (3.0 - others), axis=0)
    np.testing.assert_allclose(kernel.cost(chi2), cheapest, rtol=1e-3)
    np.testing.assert_allclose(kernel.cost(chi2), scale**2 * chi2 + PHI * (1.0 - scale) * (3.0 - scale), rtol=1e-12)


def test_switches_at_their_best_cost_what_geman_mcclure_does():
    chi2 = np.geomspace(1e-3, 1e6, 200)
    switchable, twin = Switchable(PHI), GemanMcClure(PHI)
    np.testing.assert_allclose(switchable.cost(chi2), twin.cost(chi2), rtol=1e-12)
    np.testing.assert_allclose(switchable.weight(chi2), twin.weight(chi2), rtol=1e-12)
    for switch in (-0.5, 0.0, 0.3, 1.0, 1.5):
        assert np.all(switchable.cost_at(np.full(200, switch), chi2) >= switchable.cost(chi2))


def test_max_mixture_is_the_likelier_of_two_gaussians():
    kernel = MaxMixture(PHI, null_scale=1e-3)
    chi2 = np.geomspace(1e-3, 1e6, 200)
    true = np.exp(-0.5 * chi2)
    false = kernel.null_weight * kernel.null_scale**1.5 * np.exp(-0.5 * kernel.null_scale * chi2)
    likelier = np.maximum(true, false)
    known = likelier > 1e-290
    np.testing.assert_allclose(kernel.cost(chi2)[known], -2.0 * np.log(likelier[known]), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(kernel.weight(chi2), np.where(true >= false, 1.0, 1e-3))


def test_the_surrogates_of_gnc_end_in_the_truncated_quadratic():
    chi2 = np.geomspace(1e-3, 1e6, 200)
    np.testing.assert_allclose(TruncatedQuadratic(PHI, 1e9).cost(chi2), np.minimum(chi2, PHI), rtol=1e-6)
    np.testing.assert_array_equal(kernel_of("gnc", PHI).cost(chi2), np.minimum(chi2, PHI))


def test_distrusted_edges_are_those_whose_switch_is_less_than_half_on():
    np.testing.assert_array_equal(distrusted(np.array([1.0, 0.24, 0.26, 0.0])), [1, 3])


@pytest.mark.parametrize("phi", [0.0, -1.0, math.inf, math.nan])
def test_a_phi_that_cannot_be(phi):
    for name in KERNELS:
        with pytest.raises(MapmendError, match="phi must be a number above 0"):
            kernel_of(name, phi)


def test_kernels_by_name():
    assert kernel_of("none") is None
    assert {type(kernel_of(name)) for name in KERNELS} == set(KERNELS.values())
    with pytest.raises(MapmendError, match="kernel must be none or one of huber, "):
        kernel_of("tukey")
    with pytest.raises(MapmendError, match="null_scale must lie between 0 and 1"):
        MaxMixture(null_scale=0.0)
