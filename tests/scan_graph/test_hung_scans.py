"""The poses of scans when their nodes move."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.geometry import se2
from mapmend.scan_graph.hung_scans import HungScans
from tests.scan_graph.graphs import wander

seeds = st.integers(0, 10**6)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_scans_stay_where_they_were_found_while_no_node_moves(seed):
    graph, poses = wander(seed)
    np.testing.assert_allclose(se2.between(poses, graph.scan_poses()), 0.0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds, st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3)))
def test_scans_move_as_one_with_a_map_that_moves_as_one(seed, moved_by):
    graph, poses = wander(seed)
    moved = graph.hung.scan_poses(se2.compose(moved_by, graph.chains.poses))
    np.testing.assert_allclose(se2.between(se2.compose(moved_by, poses), moved), 0.0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_scans_on_nodes_follow_their_nodes_exactly(seed):
    graph, _ = wander(seed)
    change = np.random.default_rng(seed).normal(0.0, 0.1, (len(graph), 3))
    moved = se2.compose(graph.chains.poses, change)
    on_nodes = graph.hung.scan_poses(moved)[graph.hung.node_scan]
    np.testing.assert_allclose(se2.between(moved, on_nodes), 0.0, atol=1e-12)


def test_asking_for_the_poses_of_scans_moves_nothing():
    graph, _ = wander(2)
    before = graph.chains.poses.copy(), graph.hung.T_node_scan.copy(), graph.scan_poses()
    graph.hung.scan_poses(graph.chains.poses + 1.0)
    np.testing.assert_array_equal(graph.chains.poses, before[0])
    np.testing.assert_array_equal(graph.hung.T_node_scan, before[1])
    np.testing.assert_array_equal(graph.scan_poses(), before[2])


@settings(max_examples=30, deadline=None)
@given(seeds)
def test_scans_between_two_nodes_bridge_what_the_optimizer_changed_without_a_jump(seed):
    """From node to node in 40 scans, each is as far from the next as it was, but for its share of the change."""
    graph, poses = wander(seed, nodes=5, scans_between=40)
    chains = graph.chains
    nodes = se2.compose(chains.poses, np.random.default_rng(seed).normal(0.0, 0.03, (len(graph), 3)))
    before = se2.between(poses[:-1], poses[1:])
    moved = graph.hung.scan_poses(nodes)
    after = se2.between(moved[:-1], moved[1:])
    jumps = np.abs(after - before).max(axis=1)
    step = se2.between(nodes[:-1], nodes[1:])
    size = np.abs(se2.between(chains.edges[1:], step)).max()
    assert jumps.max() < 3.0 * size / 41 + 0.05 * size
    # What the nodes moved is not lost on the way either.
    assert jumps.sum() > 0.5 * size


def hung(places, nodes):
    """Scans by the node that they hang on and their place on it; ``nodes``: the scan of each, and the step to it."""
    scans = HungScans()
    for scan, step in nodes:
        scans.note_node(scan, None if step is None else np.array(step))
    for k, (node, place) in enumerate(places):
        scans.hang(float(k), np.array([float(k), 0.0, 0.0]), node, np.array(place))
    return scans


def test_scans_along_a_step_that_was_tracked_wrong_are_laid_evenly():
    """The robot was believed to stand in a corridor, and drove 5 m past 10 scans."""
    places = [(0, (0.2 - 0.2 * 0.5**k, 0.0, 0.0)) for k in range(10)]
    scans = hung([*places, (1, (0.0, 0.0, 0.0)), (1, (0.05, 0.0, 0.0))], [(0, None), (10, (0.25, 0.0, 0.0))])
    poses = scans.scan_poses(np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0)]))
    np.testing.assert_allclose(poses[:11, 0], np.arange(11) * 0.5, atol=1e-12)
    np.testing.assert_allclose(poses[11], [5.05, 0.0, 0.0], atol=1e-12)


def test_scans_after_the_last_node_hang_on_it():
    scans = hung([(0, (0.0, 0.0, 0.0)), (0, (0.1, 0.0, 0.0)), (0, (0.2, 0.0, 0.1))], [(0, None)])
    np.testing.assert_allclose(
        scans.scan_poses(np.array([(5.0, 5.0, np.pi / 2)])),
        [[5.0, 5.0, np.pi / 2], [5.0, 5.1, np.pi / 2], [5.0, 5.2, np.pi / 2 + 0.1]],
        atol=1e-12,
    )


def test_scans_before_a_new_chain_do_not_follow_its_first_node():
    scans = hung(
        [(0, (0.0, 0.0, 0.0)), (0, (0.1, 0.0, 0.0)), (1, (0.0, 0.0, 0.0)), (1, (0.1, 0.0, 0.0))],
        [(0, None), (2, None)],
    )
    poses = scans.scan_poses(np.array([(0.0, 0.0, 0.0), (50.0, 0.0, 0.0)]))
    np.testing.assert_allclose(poses[:, 0], [0.0, 0.1, 50.0, 50.1], atol=1e-12)


def test_the_odometry_reports_motions_within_chains_only():
    scans = hung(
        [(0, (0.0, 0.0, 0.0)), (1, (0.0, 0.0, 0.0)), (2, (0.0, 0.0, 0.0))], [(0, None), (1, (1.0, 0, 0)), (2, None)]
    )
    np.testing.assert_allclose(scans.reported_motions(), [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
