"""The pose graph of a graph of scans."""

import numpy as np

from mapmend.scan_graph.loop_edges import LoopEdge
from tests.front_end.logs import empty_log
from tests.scan_graph.graphs import graph_of, wander


def test_the_pose_graph_has_all_nodes_and_edges_and_the_nodes_scans():
    scan_graph, _ = wander(3)
    information = np.diag([1.0, 2.0, 3.0])
    scan_graph.loops.append(LoopEdge(1, 9, np.array([0.1, 0.2, 0.3]), information))
    scan_graph.loops.append(LoopEdge(2, 11, np.array([0.4, 0.5, 0.6]), information))
    graph = scan_graph.pose_graph(with_scans=True)
    assert len(graph) == 12
    assert graph.edges.tolist() == [[k, k + 1] for k in range(11)] + [[1, 9], [2, 11]]
    assert graph.is_loop.tolist() == [False] * 11 + [True] * 2
    np.testing.assert_array_equal(graph.measurements[:11], scan_graph.chains.edges[1:])
    np.testing.assert_array_equal(graph.measurements[11:], [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    np.testing.assert_array_equal(graph.information[12], information)
    assert graph.scans is not None
    assert len(graph.scans) == 12
    np.testing.assert_array_equal(graph.stamps_s, scan_graph.hung.node_scan)


def test_the_pose_graph_of_one_node_has_no_edges():
    graph = graph_of(empty_log(1), [(0.0, 0.0, 0.0)], np.eye(3)).pose_graph()
    assert (len(graph), len(graph.edges), graph.measurements.shape) == (1, 0, (0, 3))
    assert graph.scans is None


def test_a_graph_given_away_does_not_move_with_the_nodes():
    scan_graph, _ = wander(4)
    graph = scan_graph.pose_graph()
    before = graph.poses.copy()
    scan_graph.chains.move(before + 1.0)
    np.testing.assert_array_equal(graph.poses, before)
