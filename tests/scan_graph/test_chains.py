"""Chains of nodes: covariances along them, stretch edges, and what follows when edges are replaced or a chain ends."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.marginals import marginals
from mapmend.graph.optimizer import optimize
from mapmend.scan_graph.chains import OdometryEdge
from tests.front_end.logs import empty_log
from tests.scan_graph.graphs import graph_of, wander

seeds = st.integers(0, 10**6)


def straight(nodes, covariance, drift):
    return graph_of(empty_log(nodes), [(0.3 * k, 0.0, 0.0) for k in range(nodes)], covariance, drift)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_the_covariance_along_the_chain_is_that_of_steps_composed_one_by_one(seed):
    chains = wander(seed)[0].chains
    for first, last in ((0, 11), (3, 4), (5, 9)):
        covariance = np.zeros((3, 3))
        for j in range(first + 1, last + 1):
            covariance = se2.compose_covariance(covariance, chains.edges[j], chains.covariances[j])
        np.testing.assert_allclose(chains.covariance_between(first, last), covariance, rtol=1e-9, atol=1e-15)


def test_the_covariance_along_the_chain_is_that_of_samples():
    chains = wander(1, nodes=6)[0].chains
    rng = np.random.default_rng(2)
    end = np.zeros((20000, 3))
    for j in range(1, 6):
        noise = rng.multivariate_normal(np.zeros(3), chains.covariances[j], 20000)
        end = se2.compose(se2.compose(end, chains.edges[j]), noise)
    mean = se2.between(chains.poses[0], chains.poses[5])
    expected = chains.covariance_between(0, 5)
    sampled = np.cov(se2.between(mean, end).T)
    np.testing.assert_allclose(sampled, expected, atol=0.06 * np.abs(np.diag(expected)).max())


def test_errors_of_nodes_within_a_stretch_cancel_and_its_drift_does_not():
    """Samples of the model of an edge's covariance: nodes matched with independent errors on a drifting grid."""
    nodes, share, std = 7, 0.1, np.array([0.01, 0.02, 0.003])
    rng = np.random.default_rng(3)
    covariance = np.diag(std**2)
    chains = straight(nodes, covariance, share * covariance).chains
    count = 40000
    own = rng.normal(size=(2, count, 3)) * std * np.sqrt(0.5 * (1.0 - share))
    end = se2.inverse(own[0])
    for edge in chains.edges[1:]:
        end = se2.compose(se2.compose(end, edge), rng.normal(size=(count, 3)) * std * np.sqrt(share))
    end = se2.compose(end, own[1])
    sampled = np.cov(se2.between(chains.poses[-1], end).T)
    expected = chains.covariance_between(0, nodes - 1)
    np.testing.assert_allclose(sampled, expected, atol=0.03 * np.diag(expected).max())
    np.testing.assert_allclose(chains.covariance_between(2, 3), covariance, rtol=1e-12, atol=1e-18)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_with_stretch_edges_the_graph_is_as_certain_as_its_stretches_are(seed):
    graph, _ = wander(seed, nodes=9, scans_between=0, drift_share=0.06)
    assert [(edge.first, edge.last) for edge in graph.chains.stretches] == [(0, 8)]
    result = optimize(graph.pose_graph())
    assert result.chi2_final == pytest.approx(0.0, abs=1e-12)
    known, expected = marginals(result.factorization)[8], graph.chains.covariance_between(0, 8)
    np.testing.assert_allclose(known, expected, atol=2e-3 * np.diag(expected).max())


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_far_along_the_chain_stretch_edges_take_most_of_what_is_counted_twice(seed):
    """Stretches within stretches are not exact: at most twice as wide or as narrow, where the chain is ten times so."""
    scan_graph, _ = wander(seed, nodes=129, scans_between=0, drift_share=0.06)
    graph = scan_graph.pose_graph()
    chain = {name: getattr(graph, name)[:128] for name in ("edges", "measurements", "information", "is_loop")}
    expected = scan_graph.chains.covariance_between(0, 128)
    widths = []
    for each in (graph, dataclasses.replace(graph, **chain)):
        known = marginals(optimize(each).factorization)[128]
        widths.append(np.linalg.det(np.linalg.solve(expected, known)) ** (1.0 / 3.0))
    assert 0.5 < widths[0] < 2.0
    assert widths[1] > 8.0


def test_where_all_of_the_errors_add_up_there_are_no_stretch_edges():
    assert not wander(6, nodes=33)[0].chains.stretches


def test_along_a_corridor_stretch_edges_tell_what_the_walls_do_and_nothing_of_the_way():
    """Across and in heading the errors of the matches cancel; along the corridor, the odometry's errors add up."""
    covariance, drift = np.diag([1e-2, 1e-4, 1e-6]), np.diag([1e-2, 6e-6, 6e-8])
    chains = straight(17, covariance, drift).chains
    assert chains.stretches
    for edge in chains.stretches:
        along = edge.information[0, 0] * (edge.last - edge.first) * covariance[0, 0]
        assert 0.0 < along < 0.01
        assert np.all(np.linalg.eigvalsh(edge.information) > 0.0)


def test_without_the_match_of_the_last_node_half_of_what_cancels_is_left():
    chains = straight(9, np.diag([4e-4, 1e-4, 1e-5]), np.diag([1e-4, 2e-5, 2e-6])).chains
    whole, of_the_map = chains.covariance_between(0, 8), chains.covariance_between(0, 8, of_last=False)
    np.testing.assert_allclose(whole - of_the_map, 0.5 * np.diag([3e-4, 8e-5, 8e-6]), atol=1e-12)


def test_a_node_is_certain_of_itself():
    chains = wander(1)[0].chains
    assert np.all(chains.covariance_between(4, 4) == 0.0)
    assert np.all(chains.covariance_between(5, 4) == 0.0)


def test_the_path_is_the_length_of_all_steps():
    chains = wander(5)[0].chains
    steps = np.hypot(*np.diff(chains.poses[:, :2], axis=0).T)
    assert chains.path_m == pytest.approx(np.concatenate(([0.0], np.cumsum(steps))))


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(1, 40))
def test_edges_replaced_one_by_one_leave_what_a_graph_built_of_them_has(seed, j):
    """The path and the stretch edges are derived anew."""
    graph, _ = wander(seed, nodes=41, scans_between=0, drift_share=0.06)
    chains = graph.chains
    old = OdometryEdge(chains.edges[j].copy(), chains.covariances[j].copy(), chains.drifts[j].copy())
    path, stretches = chains.path_m.copy(), chains.stretches
    chains.replace({j: OdometryEdge(se2.compose(old.motion, (0.5, 0.1, 0.2)), 4.0 * old.covariance, old.drift)})
    assert chains.path_m[-1] > path[-1]
    chains.replace({j: old})
    np.testing.assert_array_equal(chains.path_m, path)
    for before, after in zip(stretches, chains.stretches, strict=True):
        np.testing.assert_allclose(after.T_first_last, before.T_first_last, atol=1e-12)
        np.testing.assert_allclose(after.information, before.information)


def two_chains():
    """Two drives of 20 nodes each, the second begun elsewhere."""
    graph, _ = wander(7, nodes=20, scans_between=0, drift_share=0.06)
    chains = graph.chains
    second = chains.begin(np.array([50.0, 0.0, 0.0]))
    for _ in range(19):
        pose = se2.compose(chains.poses[-1], (0.3, 0.0, 0.1))
        chains.add(pose, OdometryEdge(np.array([0.3, 0.0, 0.1]), 1e-4 * np.eye(3), 1e-5 * np.eye(3)))
    return chains, second


def test_nothing_joins_two_chains():
    chains, second = two_chains()
    assert chains.starts == [0, second]
    assert chains.chain_of(second - 1) == (0, second)
    assert chains.chain_of(second + 5) == (second, len(chains))
    assert all(edge.last < second or edge.first >= second for edge in chains.stretches)
    assert any(edge.first >= second for edge in chains.stretches)
    np.testing.assert_array_equal(chains.edges[second], 0.0)
    with pytest.raises(MapmendError, match="no chain of odometry edges leads from node 18 to node 22"):
        chains.covariance_between(18, 22)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 39), st.floats(0.0, 9.0), st.floats(0.0, 9.0))
def test_what_lies_within_some_metres_of_a_node_is_of_its_own_chain(node, before_m, after_m):
    chains, _ = two_chains()
    begin, end = chains.chain_of(node)
    way = chains.path_m - chains.path_m[node]
    expected = [k for k in range(begin, end) if -before_m <= way[k] <= after_m]
    first, after = chains.within(node, before_m, after_m)
    assert list(range(first, after)) == expected


def test_the_path_goes_on_where_a_new_chain_begins():
    chains, second = two_chains()
    assert chains.path_m[second] == chains.path_m[second - 1]
    chains.replace({3: OdometryEdge(np.array([0.9, 0.0, 0.0]), np.eye(3), np.eye(3))})
    assert chains.path_m[second] == chains.path_m[second - 1]
