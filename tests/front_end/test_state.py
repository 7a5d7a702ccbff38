"""Nodes, edges and where scans hang: covariances along the chain, and what follows when nodes move."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.front_end.state import GraphState, LoopEdge
from mapmend.geometry import se2
from mapmend.graph.marginals import marginals
from mapmend.graph.optimizer import optimize
from tests.front_end.logs import empty_log

seeds = st.integers(0, 10**6)


def wander(seed, nodes=12, scans_between=4, drift_share=1.0):
    """A state of nodes some steps apart, ``scans_between`` scans on the way from each to the next; the scans' poses."""
    rng = np.random.default_rng(seed)
    state = GraphState(empty_log((nodes - 1) * (scans_between + 1) + 1))
    pose, scan, poses = rng.normal(size=3), 0, []
    for node in range(nodes):
        root = rng.normal(size=(3, 3)) + 4.0 * np.eye(3)
        covariance = np.linalg.inv(root @ root.T * 100.0)
        state.add_node(scan, pose, covariance, drift_share * covariance)
        poses.append(pose)
        scan += 1
        step = np.array([0.3, 0.0, rng.uniform(-0.4, 0.4)])
        if node < nodes - 1:
            for k in range(scans_between):
                on_way = se2.compose(pose, step * (k + 1) / (scans_between + 1))
                state.hang_scan(scan, node, on_way)
                poses.append(on_way)
                scan += 1
            pose = se2.compose(pose, step)
    return state, np.array(poses)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_the_covariance_along_the_chain_is_that_of_steps_composed_one_by_one(seed):
    state, _ = wander(seed)
    for first, last in ((0, 11), (3, 4), (5, 9)):
        covariance = np.zeros((3, 3))
        for j in range(first + 1, last + 1):
            covariance = se2.compose_covariance(covariance, state.odometry_edge[j], state.odometry_covariance[j])
        np.testing.assert_allclose(state.covariance_between(first, last), covariance, rtol=1e-9, atol=1e-15)


def test_the_covariance_along_the_chain_is_that_of_samples():
    state, _ = wander(1, nodes=6)
    rng = np.random.default_rng(2)
    end = np.zeros((20000, 3))
    for j in range(1, 6):
        noise = rng.multivariate_normal(np.zeros(3), state.odometry_covariance[j], 20000)
        end = se2.compose(se2.compose(end, state.odometry_edge[j]), noise)
    mean = se2.between(state.node_pose[0], state.node_pose[5])
    expected = state.covariance_between(0, 5)
    sampled = np.cov(se2.between(mean, end).T)
    np.testing.assert_allclose(sampled, expected, atol=0.06 * np.abs(np.diag(expected)).max())


def test_errors_of_nodes_within_a_stretch_cancel_and_its_drift_does_not():
    """Samples of what an edge's covariance stands for: nodes matched with errors of their own on a drifting grid."""
    nodes, share, std = 7, 0.1, np.array([0.01, 0.02, 0.003])
    rng = np.random.default_rng(3)
    state = GraphState(empty_log(nodes))
    covariance = np.diag(std**2)
    for k in range(nodes):
        state.add_node(k, np.array([0.3 * k, 0.0, 0.0]), covariance, share * covariance)
    count = 40000
    own = rng.normal(size=(2, count, 3)) * std * np.sqrt(0.5 * (1.0 - share))
    end = se2.inverse(own[0])
    for edge in state.odometry_edge[1:nodes]:
        end = se2.compose(se2.compose(end, edge), rng.normal(size=(count, 3)) * std * np.sqrt(share))
    end = se2.compose(end, own[1])
    sampled = np.cov(se2.between(state.node_pose[nodes - 1], end).T)
    expected = state.covariance_between(0, nodes - 1)
    np.testing.assert_allclose(sampled, expected, atol=0.03 * np.diag(expected).max())
    np.testing.assert_allclose(state.covariance_between(2, 3), covariance, rtol=1e-12, atol=1e-18)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_with_stretch_edges_the_graph_is_as_certain_as_its_stretches_are(seed):
    state, _ = wander(seed, nodes=9, scans_between=0, drift_share=0.06)
    assert [(edge.first, edge.last) for edge in state.stretches] == [(0, 8)]
    result = optimize(state.pose_graph())
    assert result.chi2_final == pytest.approx(0.0, abs=1e-12)
    known, expected = marginals(result.factorization)[8], state.covariance_between(0, 8)
    np.testing.assert_allclose(known, expected, atol=2e-3 * np.diag(expected).max())


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_far_along_the_chain_stretch_edges_take_most_of_what_is_counted_twice(seed):
    """Stretches within stretches are not exact: at most twice as wide or as narrow, where the chain is ten times so."""
    state, _ = wander(seed, nodes=129, scans_between=0, drift_share=0.06)
    graph = state.pose_graph()
    chain = {name: getattr(graph, name)[:128] for name in ("edges", "measurements", "information", "is_loop")}
    expected = state.covariance_between(0, 128)
    widths = []
    for each in (graph, dataclasses.replace(graph, **chain)):
        known = marginals(optimize(each).factorization)[128]
        widths.append(np.linalg.det(np.linalg.solve(expected, known)) ** (1.0 / 3.0))
    assert 0.5 < widths[0] < 2.0
    assert widths[1] > 8.0


def test_where_all_of_the_errors_add_up_there_are_no_stretch_edges():
    state, _ = wander(6, nodes=33)
    assert not state.stretches


def test_along_a_corridor_stretch_edges_tell_what_the_walls_do_and_nothing_of_the_way():
    """Across and in heading the matches cancel; along, only the odometry counted, and adds up."""
    state = GraphState(empty_log(17))
    covariance, drift = np.diag([1e-2, 1e-4, 1e-6]), np.diag([1e-2, 6e-6, 6e-8])
    for k in range(17):
        state.add_node(k, np.array([0.3 * k, 0.0, 0.0]), covariance, drift)
    assert state.stretches
    for edge in state.stretches:
        along = edge.information[0, 0] * (edge.last - edge.first) * covariance[0, 0]
        assert 0.0 < along < 0.01
        assert np.all(np.linalg.eigvalsh(edge.information) > 0.0)


def test_a_node_is_certain_of_itself():
    state, _ = wander(1)
    assert np.all(state.covariance_between(4, 4) == 0.0)
    assert np.all(state.covariance_between(5, 4) == 0.0)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_scans_stay_where_they_were_found_while_no_node_moves(seed):
    state, poses = wander(seed)
    difference = se2.between(poses, state.scan_poses())
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds, st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3)))
def test_scans_move_as_one_with_a_map_that_moves_as_one(seed, moved_by):
    state, poses = wander(seed)
    n = state.count
    state.node_pose[:n] = se2.compose(moved_by, state.node_pose[:n])
    np.testing.assert_allclose(se2.between(se2.compose(moved_by, poses), state.scan_poses()), 0.0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_scans_on_nodes_follow_their_nodes_exactly(seed):
    state, _ = wander(seed)
    n = state.count
    state.node_pose[:n] = se2.compose(state.node_pose[:n], np.random.default_rng(seed).normal(0.0, 0.1, (n, 3)))
    on_nodes = state.scan_poses()[state.node_scan[:n]]
    np.testing.assert_allclose(se2.between(state.node_pose[:n], on_nodes), 0.0, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_scans_between_two_nodes_bridge_what_the_optimizer_changed_without_a_jump(seed):
    """From node to node in 40 scans, each is as far from the next as it was, but for its share of the change."""
    state, poses = wander(seed, nodes=5, scans_between=40)
    n = state.count
    change = np.random.default_rng(seed).normal(0.0, 0.03, (n, 3))
    state.node_pose[:n] = se2.compose(state.node_pose[:n], change)
    before, after = se2.between(poses[:-1], poses[1:]), np.zeros((len(poses) - 1, 3))
    moved = state.scan_poses()
    after = se2.between(moved[:-1], moved[1:])
    jumps = np.abs(after - before).max(axis=1)
    step = se2.between(state.node_pose[: n - 1], state.node_pose[1:n])
    size = np.abs(se2.between(state.odometry_edge[1:n], step)).max()
    assert jumps.max() < 3.0 * size / 41 + 0.05 * size
    # What the nodes moved is not lost on the way either.
    assert jumps.sum() > 0.5 * size


def test_scans_along_a_step_that_was_tracked_wrong_are_laid_evenly():
    """The robot was believed to stand in a corridor, and drove 5 m past 10 scans."""
    state = GraphState(empty_log(12))
    state.add_node(0, np.zeros(3), np.eye(3), np.eye(3))
    for k in range(1, 10):
        state.hang_scan(k, 0, np.array([0.2 - 0.2 * 0.5**k, 0.0, 0.0]))
    state.add_node(10, np.array([0.25, 0.0, 0.0]), np.eye(3), np.eye(3))
    state.hang_scan(11, 1, np.array([0.3, 0.0, 0.0]))
    state.node_pose[1] = (5.0, 0.0, 0.0)
    np.testing.assert_allclose(state.scan_poses()[:11, 0], np.arange(11) * 0.5, atol=1e-12)
    np.testing.assert_allclose(state.scan_poses()[11], [5.05, 0.0, 0.0], atol=1e-12)


def test_scans_after_the_last_node_hang_on_it():
    log = empty_log(3)
    state = GraphState(log)
    state.add_node(0, np.zeros(3), np.eye(3), np.eye(3))
    state.hang_scan(1, 0, np.array([0.1, 0.0, 0.0]))
    state.hang_scan(2, 0, np.array([0.2, 0.0, 0.1]))
    state.node_pose[0] = (5.0, 5.0, np.pi / 2)
    np.testing.assert_allclose(
        state.scan_poses(), [[5.0, 5.0, np.pi / 2], [5.0, 5.1, np.pi / 2], [5.0, 5.2, np.pi / 2 + 0.1]], atol=1e-12
    )


def test_the_pose_graph_has_all_nodes_and_edges_and_the_nodes_scans():
    state, _ = wander(3)
    information = np.diag([1.0, 2.0, 3.0])
    state.loops.append(LoopEdge(1, 9, np.array([0.1, 0.2, 0.3]), information))
    state.loops.append(LoopEdge(2, 11, np.array([0.4, 0.5, 0.6]), information))
    graph = state.pose_graph(with_scans=True)
    assert len(graph) == 12
    assert graph.edges.tolist() == [[k, k + 1] for k in range(11)] + [[1, 9], [2, 11]]
    assert graph.is_loop.tolist() == [False] * 11 + [True] * 2
    np.testing.assert_array_equal(graph.measurements[:11], state.odometry_edge[1:12])
    np.testing.assert_array_equal(graph.measurements[11:], [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    np.testing.assert_array_equal(graph.information[12], information)
    assert graph.scans is not None
    assert len(graph.scans) == 12
    np.testing.assert_array_equal(graph.stamps_s, state.node_scan[:12])


def test_the_pose_graph_of_one_node_has_no_edges():
    state = GraphState(empty_log(1))
    state.add_node(0, np.zeros(3), np.eye(3), np.eye(3))
    graph = state.pose_graph()
    assert (len(graph), len(graph.edges), graph.measurements.shape) == (1, 0, (0, 3))
    assert graph.scans is None


def test_a_graph_given_away_does_not_move_with_the_state():
    state, _ = wander(4)
    graph = state.pose_graph()
    before = graph.poses.copy()
    state.node_pose += 1.0
    np.testing.assert_array_equal(graph.poses, before)


def test_the_path_is_the_length_of_all_steps():
    state, _ = wander(5)
    steps = np.hypot(*np.diff(state.node_pose[:12, :2], axis=0).T)
    assert state.node_path_m[:12] == pytest.approx(np.concatenate(([0.0], np.cumsum(steps))))
