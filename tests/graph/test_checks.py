"""Every graph that is refused, and the line that says why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapmend.errors import MapmendError
from mapmend.graph.optimizer import OptimizerSettings, optimize
from tests.graph.graphs import random_graph


def changed(array, where, value):
    array = array.copy()
    array[where] = value
    return array


@pytest.fixture
def graph():
    """Ids are 7, 17, 27, ...; edge k < 11 joins node k to node k + 1."""
    return random_graph(0)


def refuse(graph, match, **arguments):
    with pytest.raises(MapmendError, match=match) as caught:
        optimize(graph, **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_numbers_that_are_not_finite(graph, value):
    refuse(replace(graph, poses=changed(graph.poses, (2, 1), value)), "the pose of node 27 is not finite")
    bad = changed(graph.measurements, (3, 2), value)
    refuse(replace(graph, measurements=bad), "the measurement of edge 37 -> 47 is not finite")
    bad = changed(graph.information, (3, 2, 2), value)
    refuse(replace(graph, information=bad), "the information of edge 37 -> 47 is not finite")


@pytest.mark.parametrize(
    "information",
    [
        np.zeros((3, 3)),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    ],
)
def test_information_that_is_not_positive_definite(graph, information):
    bad = changed(graph.information, 4, information)
    refuse(replace(graph, information=bad), "the information of edge 47 -> 57 is not positive definite")


def test_information_that_is_not_symmetric(graph):
    bad = changed(graph.information, (4, 0, 1), 1e3)
    refuse(replace(graph, information=bad), "the information of edge 47 -> 57 is not symmetric")


def test_information_that_spans_many_scales_is_fine(graph):
    wide = np.broadcast_to(np.diag([1e6, 1e-3, 1e5]), graph.information.shape)
    assert optimize(replace(graph, information=wide)).converged


def test_an_edge_from_a_node_to_itself(graph):
    refuse(replace(graph, edges=changed(graph.edges, 5, [6, 6])), "edge 67 -> 67 joins a node to itself")


def test_two_nodes_of_one_name(graph):
    refuse(replace(graph, ids=changed(graph.ids, 7, 37)), "two nodes of the graph are called 37")
    assert optimize(replace(graph, ids=graph.ids[::-1].copy())).converged


def test_an_edge_to_a_node_that_there_is_not(graph):
    with pytest.raises(MapmendError, match=r"an edge names a node outside 0\.\.11"):
        replace(graph, edges=changed(graph.edges, (3, 1), 12))


def test_a_node_without_edges(graph):
    alone = ~(graph.edges == 8).any(axis=1)
    bare = replace(
        graph,
        edges=graph.edges[alone],
        measurements=graph.measurements[alone],
        information=graph.information[alone],
        is_loop=graph.is_loop[alone],
        fixed=(0, 11),
    )
    refuse(bare, r"no chain of edges joins node 87 to a fixed node \(1 of 12 nodes are not connected to one\)")


def test_a_part_that_hangs_on_no_fixed_node(graph):
    chain = random_graph(0, loops=0)
    kept = np.arange(11) != 6
    torn = replace(
        chain,
        edges=chain.edges[kept],
        measurements=chain.measurements[kept],
        information=chain.information[kept],
        is_loop=chain.is_loop[kept],
    )
    refuse(torn, r"no chain of edges joins node 77 to a fixed node \(5 of 12 nodes are not connected to one\)")
    assert optimize(replace(torn, fixed=(0, 9))).converged


def test_a_graph_without_a_fixed_node_or_with_a_wrong_one(graph):
    refuse(replace(graph, fixed=()), "no node is fixed, .* such as node 7")
    refuse(replace(graph, fixed=(12,)), r"a fixed node is outside 0\.\.11")


def test_a_graph_without_edges(graph):
    bare = replace(
        graph,
        edges=graph.edges[:0],
        measurements=graph.measurements[:0],
        information=graph.information[:0],
        is_loop=graph.is_loop[:0],
    )
    refuse(bare, "no chain of edges joins node 17 to a fixed node")


def test_weights_that_cannot_be(graph):
    count = len(graph.edges)
    refuse(graph, rf"weights must have shape \({count},\), got \(3,\)", weights=np.ones(3))
    refuse(graph, "the weight of edge 27 -> 37 is negative", weights=changed(np.ones(count), 2, -1.0))
    refuse(graph, "the weight of edge 27 -> 37 is negative or not", weights=changed(np.ones(count), 2, np.nan))
    refuse(graph, "singular", weights=np.zeros(count))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_numbers_too_large_to_square(graph):
    refuse(graph.with_poses(changed(graph.poses, (2, 0), 1e200)), "chi2 .* not finite")


def test_a_system_of_another_graph(graph):
    system = optimize(random_graph(1)).system
    refuse(graph, "made for other edges", system=system)


def test_settings_that_cannot_be():
    with pytest.raises(MapmendError, match="method must be one of"):
        OptimizerSettings(method="dogleg")
    with pytest.raises(MapmendError, match="max_iterations"):
        OptimizerSettings(max_iterations=-1)
    with pytest.raises(MapmendError, match="tolerance"):
        OptimizerSettings(tolerance_sigma=float("nan"))
