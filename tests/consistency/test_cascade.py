"""The cascaded test: its scales, its binomial tails, and the level of each stage."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from mapmend.config import ConsistencyConfig
from mapmend.consistency.cascade import judge_pairs, judge_scans, map_p_value, survival
from mapmend.consistency.measure import PairMeasures, measure_pairs
from mapmend.consistency.scale import (
    HALF_NORMAL_MEAN,
    HALF_NORMAL_STD,
    estimate_scales,
    implied_scale,
    odometry_map,
    pair_scales,
)
from mapmend.consistency.visibility import view_scans
from mapmend.geometry import se2
from tests.consistency.scenes import graph_of, room_graph
from tests.reference.consistency_cascade import binomial_tail, most_failures

CONFIG = ConsistencyConfig()


@given(st.integers(0, 60), st.integers(1, 60), st.floats(0.001, 0.3))
@settings(deadline=None)
def test_without_dependence_the_tail_is_the_papers(at_least, of, level):
    expected = binomial_tail(at_least, of, level) if at_least <= of else 0.0
    assert survival(np.array([at_least]), np.array([of]), level, 0.0)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("tests", [1, 5, 40, 300])
def test_a_scan_fails_beyond_the_papers_most_failures(tests):
    most = most_failures(tests, 0.015, 0.01)
    p_values = survival(np.arange(tests + 1), np.full(tests + 1, tests), 0.015, 0.0)
    # P(more than most) is within the level, P(more than one less) is not.
    assert (p_values[1:] <= 0.01).tolist() == [failures > most for failures in range(1, tests + 1)]


@given(st.integers(1, 40), st.floats(0.005, 0.2), st.floats(0.01, 0.5))
@settings(deadline=None)
def test_dependence_keeps_the_mean_and_widens_the_tail(of, level, dependence):
    k = np.arange(1, of + 1)
    p_values = survival(k, np.full(of, of), level, dependence)
    assert p_values.sum() == pytest.approx(of * level, rel=1e-6)  # the mean of a count is the sum of its tails
    assert np.all(np.diff(p_values) <= 1e-12)
    assert p_values[-1] >= level**of - 1e-12  # rounding hides smaller tails


def test_half_normal_moments():
    sample = np.abs(np.random.default_rng(0).standard_normal(400_000))
    assert sample.mean() == pytest.approx(HALF_NORMAL_MEAN, abs=4.0 * HALF_NORMAL_STD / math.sqrt(400_000))
    assert sample.std() == pytest.approx(HALF_NORMAL_STD, abs=0.005)


@given(st.floats(0.001, 1.0), st.integers(1, 400), st.floats(0.001, 0.3))
@settings(deadline=None)
def test_at_its_implied_scale_a_pair_just_passes(scale, points, level):
    z = norm.isf(level)
    total = scale * (points * HALF_NORMAL_MEAN + z * math.sqrt(points) * HALF_NORMAL_STD)
    assert implied_scale(np.array([total]), np.array([points]), level)[0] == pytest.approx(scale)


def measures_of(pairs, points, totals):
    points = np.asarray(points, dtype=np.int64)
    totals = np.asarray(totals, dtype=np.float64)
    return PairMeasures(np.asarray(pairs, dtype=np.int64), points, totals, points, totals, len(points))


def test_pairs_of_independent_half_normal_depths_fail_at_their_level():
    rng = np.random.default_rng(1)
    count, points, scale = 40_000, 80, 0.04
    totals = np.abs(scale * rng.standard_normal((count, points))).sum(axis=1)
    pairs = np.stack((np.arange(count), np.arange(count) + 1), axis=1)
    config = ConsistencyConfig(least_inflation=1.0, most_inflation=1.0, prior_std_m=1e-9)
    tests = judge_pairs(measures_of(pairs, np.full(count, points), totals), np.full(count + 1, scale), config)
    share = tests.failed.mean()
    assert share == pytest.approx(0.01, rel=0.35)  # the sum of 80 half-normal depths is not quite normal
    np.testing.assert_array_equal(tests.failed, tests.psi > norm.isf(0.01))


def test_the_larger_scale_of_a_pair_counts():
    pairs = np.array([(0, 1), (1, 2)])
    scales = pair_scales(np.array([0.01, 0.04, 0.02]), pairs, ConsistencyConfig(prior_std_m=0.03))
    np.testing.assert_allclose(scales, np.hypot(0.04, 0.03))


def test_pairs_with_few_points_are_not_tested():
    tests = judge_pairs(measures_of([(0, 1), (0, 2)], [9, 10], [9.0, 10.0]), np.full(3, 0.01), CONFIG)
    assert tests.pairs.tolist() == [[0, 2]]
    scans = judge_scans(tests, 3, CONFIG)
    assert scans.tested.tolist() == [1, 0, 1]
    assert scans.failures.tolist() == [1, 0, 1]


def test_a_map_without_tested_pairs_is_consistent():
    nothing = np.zeros((0, 2), dtype=np.int64)
    scans = judge_scans(judge_pairs(measures_of(nothing, [], []), np.full(4, 0.01), CONFIG), 4, CONFIG)
    assert not scans.failed.any()
    assert map_p_value(scans, CONFIG) == 1.0


def test_odometry_edges_over_several_nodes_are_no_short_cuts():
    """The front end's stretch edges join nodes eight apart; neighbours along the odometry stay those of the chain."""
    graph = room_graph(20)
    stretch = replace(
        graph,
        edges=np.concatenate((graph.edges, [(0, 8), (8, 16)])),
        measurements=np.concatenate((graph.measurements, np.full((2, 3), 9.0))),
        information=np.concatenate((graph.information, graph.information[:2])),
        is_loop=np.concatenate((graph.is_loop, [False, False])),
    )
    for name in ("poses", "chain", "position"):
        np.testing.assert_array_equal(getattr(odometry_map(stretch), name), getattr(odometry_map(graph), name))


def test_the_odometry_map_is_the_edges_laid_end_to_end():
    graph = room_graph()
    bent = graph.with_poses(graph.poses + np.arange(12)[:, None] * 0.1)
    expected = se2.compose(bent.poses[0], se2.between(graph.poses[0], graph.poses))
    laid = odometry_map(bent)
    np.testing.assert_allclose(laid.poses, expected, atol=1e-12)
    assert laid.position.tolist() == list(range(12))
    pairs = laid.neighbours(3, 1e3)
    assert {(b - a) for a, b in pairs.tolist()} == {1, 2, 3}
    assert len(pairs) == 11 + 10 + 9
    step_m = np.hypot(*(graph.poses[1] - graph.poses[0])[:2])
    assert 11 <= len(laid.neighbours(3, 1.5 * step_m)) < 20  # the turn is made in place


def test_odometry_edges_may_point_backwards_and_chains_be_several():
    graph = room_graph(with_loop=False)
    edges = graph.edges[:, ::-1].copy()
    backwards = graph_of(graph.poses, graph.scans)
    object.__setattr__(backwards, "edges", edges)
    object.__setattr__(backwards, "measurements", se2.inverse(graph.measurements))
    np.testing.assert_allclose(odometry_map(backwards).poses, odometry_map(graph).poses, atol=1e-12)
    halves = graph_of(graph.poses, graph.scans)
    keep = np.arange(11) != 5
    for name in ("edges", "measurements", "information", "is_loop"):
        object.__setattr__(halves, name, getattr(graph, name)[keep])
    laid = odometry_map(halves)
    assert laid.chain.tolist() == [0] * 6 + [6] * 6
    assert all((a < 6) == (b < 6) for a, b in laid.neighbours(4, 1e3).tolist())


def test_all_pairs_along_the_odometry_pass_at_their_own_scales():
    graph = room_graph(24)
    scales = estimate_scales(view_scans(graph.scans, CONFIG), odometry_map(graph), CONFIG)
    config = ConsistencyConfig(pair_level=CONFIG.scale_level, least_inflation=1.0, most_inflation=1.0)
    views = view_scans(graph.scans, config).placed(odometry_map(graph).poses)
    measures = measure_pairs(views, drop=(config.drop_points, config.drop_share))
    near = measures.pairs[:, 1] - measures.pairs[:, 0] <= config.neighbours
    tests = judge_pairs(measures, scales, config)
    enough = measures.kept >= config.min_points
    assert near[enough].any()
    assert not tests.failed[near[enough]].any()
