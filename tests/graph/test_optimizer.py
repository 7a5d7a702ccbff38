"""The optimum: against dense algebra, and its invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.geometry import se2
from mapmend.graph.optimizer import METHODS, OptimizerSettings, edge_chi2, edge_errors, optimize
from mapmend.graph.system import System
from tests.graph.graphs import consistent, perturbed, random_graph
from tests.reference import graph_linearization as reference

TIGHT = OptimizerSettings(tolerance_sigma=1e-9, tolerance_share=1e-15)
seeds = st.integers(0, 10_000)
several = settings(max_examples=15, deadline=None)


def assert_same_poses(got, expected, tolerance=1e-6):
    difference = got - expected
    difference[:, 2] = se2.wrap_angle(difference[:, 2])
    np.testing.assert_allclose(difference, 0.0, atol=tolerance)


@several
@given(seeds, st.sampled_from([(0,), (4, 7)]), st.sampled_from(METHODS))
def test_the_optimum_is_that_of_dense_algebra(seed, fixed, method):
    graph = replace(perturbed(random_graph(seed), seed, 0.02), fixed=fixed)
    result = optimize(graph, replace(TIGHT, method=method))
    expected = reference.gauss_newton(graph)
    assert_same_poses(result.poses, expected.poses)
    assert result.chi2_final == pytest.approx(reference.dense_system(expected)[0], rel=1e-9)
    assert result.chi2_initial == pytest.approx(reference.dense_system(graph)[0], rel=1e-9)
    np.testing.assert_array_equal(result.poses[list(fixed)], graph.poses[list(fixed)])


@several
@given(seeds)
def test_a_perturbed_start_returns_to_a_consistent_graph(seed):
    graph = consistent(random_graph(seed))
    assert edge_chi2(graph).sum() == pytest.approx(0.0, abs=1e-18)
    result = optimize(perturbed(graph, seed, 0.05), TIGHT)
    assert result.converged
    assert result.chi2_final == pytest.approx(0.0, abs=1e-15)
    assert_same_poses(result.poses, graph.poses)


@several
@given(seeds)
def test_the_order_of_the_edges_does_not_matter(seed):
    graph = random_graph(seed)
    order = np.random.default_rng(seed).permutation(len(graph.edges))
    shuffled = replace(
        graph,
        edges=graph.edges[order],
        measurements=graph.measurements[order],
        information=graph.information[order],
        is_loop=graph.is_loop[order],
    )
    assert_same_poses(optimize(shuffled, TIGHT).poses, optimize(graph, TIGHT).poses)


@several
@given(seeds, st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3)))
def test_a_rigid_motion_of_the_graph_moves_the_optimum_along(seed, motion):
    graph = random_graph(seed)
    moved = graph.with_poses(se2.compose(motion, graph.poses))
    still, result = optimize(graph, TIGHT), optimize(moved, TIGHT)
    assert_same_poses(result.poses, se2.compose(motion, still.poses))
    assert result.chi2_final == pytest.approx(still.chi2_final, rel=1e-9)


@several
@given(seeds)
def test_whole_turns_of_the_angles_do_not_matter(seed):
    graph = random_graph(seed)
    turns = 2.0 * np.pi * np.random.default_rng(seed).integers(-3, 4, size=(len(graph), 1))
    turned = graph.with_poses(graph.poses + turns * np.array([0.0, 0.0, 1.0]))
    assert_same_poses(optimize(turned, TIGHT).poses, optimize(graph, TIGHT).poses)


def test_weights_are_factors_on_the_information():
    graph = random_graph(3)
    weights = np.random.default_rng(3).uniform(0.1, 2.0, len(graph.edges))
    weighted = replace(graph, information=graph.information * weights[:, None, None])
    np.testing.assert_array_equal(optimize(graph, weights=weights).poses, optimize(weighted).poses)
    without = optimize(graph, TIGHT, weights=(~graph.is_loop).astype(np.float64))
    assert without.chi2_final == pytest.approx(0.0, abs=1e-12)


def test_a_system_serves_again_with_the_same_result():
    graph = random_graph(5, nodes=30, loops=20)
    first = optimize(graph)
    other = replace(graph, information=2.0 * graph.information, poses=perturbed(graph, 5, 0.02).poses)
    again = optimize(other, TIGHT, system=first.system)
    assert_same_poses(again.poses, optimize(other, TIGHT).poses)
    # A factor that is requested late belongs to its own result, not to the last one.
    fresh = optimize(graph)
    np.testing.assert_array_equal(first.factorization.lower, fresh.factorization.lower)
    assert first.system.matches(other)
    assert not first.system.matches(replace(graph, fixed=(1,)))


def test_chi2_never_rises_from_a_bad_start():
    graph = perturbed(random_graph(6, nodes=40, loops=40), 6, 3.0)
    chi2 = [
        optimize(graph, OptimizerSettings(max_iterations=limit)).chi2_final for limit in (0, 1, 2, 3, 5, 8, 13, 200)
    ]
    assert np.all(np.diff(chi2) <= 0.0)
    assert chi2[0] == pytest.approx(edge_chi2(graph).sum())


def test_chi2_and_errors_of_every_edge():
    graph = random_graph(7)
    errors, chi2 = edge_errors(graph), edge_chi2(graph)
    for k, (i, j) in enumerate(graph.edges):
        expected = reference.error(graph.poses[i], graph.poses[j], graph.measurements[k])
        np.testing.assert_allclose(errors[k], expected, atol=1e-12)
        assert chi2[k] == pytest.approx(expected @ graph.information[k] @ expected)
    assert optimize(graph).chi2_initial == pytest.approx(chi2.sum())


def test_the_result_says_what_was_done():
    told = []
    result = optimize(random_graph(8), progress=lambda stage, done, total: told.append((stage, done, total)))
    assert result.converged
    assert told == [("optimize", k + 1, 100) for k in range(result.iterations)]
    assert result.seconds.keys() == {"analyse", "solve"}
    cut_short = optimize(perturbed(random_graph(8), 8, 0.5), OptimizerSettings(max_iterations=1))
    assert (cut_short.iterations, cut_short.converged) == (1, False)


def test_the_given_graph_is_left_alone():
    graph = perturbed(random_graph(9), 9, 0.1)
    before = graph.poses.copy()
    optimize(graph)
    np.testing.assert_array_equal(graph.poses, before)


@pytest.mark.parametrize("nodes", [0, 1, 3])
def test_a_graph_without_unknowns_stays_as_it_is(nodes):
    graph = replace(random_graph(1, nodes=max(nodes, 2), loops=0), fixed=tuple(range(nodes)))
    if nodes < 2:
        empty = np.zeros(0, dtype=np.int64)
        graph = replace(
            graph,
            poses=graph.poses[:nodes],
            ids=graph.ids[:nodes],
            edges=empty.reshape(0, 2),
            measurements=np.zeros((0, 3)),
            information=np.zeros((0, 3, 3)),
            is_loop=empty.astype(np.bool_),
        )
    result = optimize(graph)
    np.testing.assert_array_equal(result.poses, graph.poses)
    assert (result.iterations, result.converged) == (0, True)
    assert result.chi2_final == pytest.approx(edge_chi2(graph).sum())
    assert System(graph).size == 0
