"""Covariances from the factor against dense algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph import _marginal_kernels
from mapmend.graph.marginals import cross_covariances, joint_covariance, marginals, relative_covariances
from mapmend.graph.optimizer import optimize
from mapmend.graph.system import System
from tests.graph.graphs import perturbed, random_graph
from tests.reference import graph_elimination as elimination
from tests.reference import graph_linearization as reference

FIXED = st.sampled_from([(0,), (5,), (2, 3, 11)])


def factorized(graph):
    system = System(graph)
    return system.factorize(system.linearize(graph.poses, graph.measurements, graph.information).values)


def blocks_of(covariance):
    n = len(covariance) // 3
    return covariance.reshape(n, 3, n, 3).swapaxes(1, 2)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 60), st.integers(0, 60))
def test_the_sparse_inverse_subset_is_the_inverse_on_the_pattern(seed, nodes, loops):
    f = factorized(random_graph(seed, nodes, loops))
    fronts = f.elimination.fronts
    lower = elimination.dense_lower(fronts, f.lower)
    expected = np.linalg.inv(lower @ lower.T)
    inverse = _marginal_kernels.sparse_inverse(fronts, f.lower, np.empty(f.elimination.work_size))
    stored = elimination.dense_panels(fronts, np.ones_like(f.lower)) > 0.0
    got = elimination.dense_panels(fronts, inverse)
    np.testing.assert_allclose(got[stored], expected[stored], rtol=1e-7, atol=1e-9 * np.abs(expected).max())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), FIXED)
def test_marginals_are_the_diagonal_blocks_of_the_inverse(seed, fixed):
    graph = replace(perturbed(random_graph(seed), seed, 0.2), fixed=fixed)
    expected = blocks_of(reference.dense_covariance(graph))
    got = marginals(factorized(graph))
    for k in range(len(graph)):
        np.testing.assert_allclose(got[k], expected[k, k], rtol=1e-8, atol=1e-9 * np.abs(expected[k, k]).max())
    assert np.all(got[list(fixed)] == 0.0)
    np.testing.assert_array_equal(got, np.swapaxes(got, 1, 2))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), FIXED, st.integers(0, 11))
def test_cross_covariances_are_a_block_column_of_the_inverse(seed, fixed, node):
    graph = replace(perturbed(random_graph(seed), seed, 0.2), fixed=fixed)
    expected = blocks_of(reference.dense_covariance(graph))[:, node]
    np.testing.assert_allclose(cross_covariances(factorized(graph), node), expected, atol=1e-9 * np.abs(expected).max())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), FIXED, st.integers(0, 11), st.integers(0, 11))
def test_the_joint_covariance_of_two_nodes(seed, fixed, first, second):
    graph = replace(perturbed(random_graph(seed), seed, 0.2), fixed=fixed)
    rows = np.array([3 * first + np.arange(3), 3 * second + np.arange(3)]).ravel()
    expected = reference.dense_covariance(graph)[np.ix_(rows, rows)]
    got = joint_covariance(factorized(graph), first, second)
    np.testing.assert_allclose(got, expected, atol=1e-9 * np.abs(expected).max())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), FIXED, st.integers(0, 11))
def test_relative_covariances_against_dense_algebra(seed, fixed, node):
    graph = replace(perturbed(random_graph(seed), seed, 0.2), fixed=fixed)
    covariance = reference.dense_covariance(graph)
    f = factorized(graph)
    got = relative_covariances(f, graph.poses, marginals(f), node)
    for other in range(len(graph)):
        # The error of an edge other -> node that measures what is there has the relative pose for its error.
        measurement = se2.between(graph.poses[other], graph.poses[node])
        J = np.zeros((3, 3 * len(graph)))
        by_other, by_node = reference.jacobians(graph.poses[other], graph.poses[node], measurement)
        J[:, 3 * other : 3 * other + 3] += by_other
        J[:, 3 * node : 3 * node + 3] += by_node
        expected = J @ covariance @ J.T
        np.testing.assert_allclose(got[other], expected, atol=1e-8 * np.abs(covariance).max())
    np.testing.assert_allclose(got[node], 0.0, atol=1e-12)
    some = np.array([7, 1])
    np.testing.assert_array_equal(relative_covariances(f, graph.poses, marginals(f), node, some), got[some])


def test_along_a_chain_covariances_compose():
    graph = random_graph(9, nodes=6, loops=0)
    covariance = np.zeros((3, 3))
    for k in range(5):
        covariance = se2.compose_covariance(covariance, graph.measurements[k], np.linalg.inv(graph.information[k]))
    result = optimize(graph)
    exact = marginals(result.factorization)
    np.testing.assert_allclose(exact[5], covariance, rtol=1e-6, atol=1e-12)
    relative = relative_covariances(result.factorization, result.poses, exact, 3, np.array([2]))[0]
    np.testing.assert_allclose(relative, np.linalg.inv(graph.information[2]), rtol=1e-6, atol=1e-12)


def test_a_loop_makes_its_nodes_surer():
    open_chain = random_graph(10, nodes=10, loops=0)
    closed = random_graph(10, nodes=10, loops=4)
    before, after = marginals(factorized(open_chain)), marginals(factorized(replace(closed, poses=open_chain.poses)))
    assert after[-1].trace() < before[-1].trace()


def test_covariances_of_a_fixed_graph_are_zero():
    graph = replace(random_graph(1, nodes=3, loops=0), fixed=(0, 1, 2))
    f = optimize(graph).factorization
    assert not marginals(f).any()
    assert not cross_covariances(f, 1).any()


def test_a_node_that_does_not_exist_is_refused():
    f = factorized(random_graph(1))
    with pytest.raises(MapmendError, match="no node 12 in a graph of 12"):
        cross_covariances(f, 12)
