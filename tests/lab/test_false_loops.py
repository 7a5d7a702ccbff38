"""False loops on demand: what they are, and that they are the same each time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.lab.false_loops import FALSE_LOOP_KINDS, GROUP_SIZE, LOCAL_NODES, add_false_loops
from tests.graph.graphs import random_graph

kinds = st.sampled_from(FALSE_LOOP_KINDS)


@settings(max_examples=40, deadline=None)
@given(kinds, st.integers(0, 150), st.integers(0, 10_000), st.integers(GROUP_SIZE + 2, 60))
def test_what_is_added_is_marked_and_joins_nodes_of_the_graph(kind, count, seed, nodes):
    graph = random_graph(1, nodes=nodes)
    spoiled = add_false_loops(graph, kind, count, seed)
    m = len(graph.edges)
    assert np.array_equal(np.flatnonzero(spoiled.is_false), m + np.arange(count))
    np.testing.assert_array_equal(spoiled.graph.edges[:m], graph.edges)
    np.testing.assert_array_equal(spoiled.graph.measurements[:m], graph.measurements)
    assert spoiled.graph.is_loop[m:].all()
    span = np.diff(spoiled.graph.edges[m:], axis=1)[:, 0]
    assert np.all(span >= 2)
    assert kind.startswith("random") or np.all(span <= LOCAL_NODES)
    lenders = graph.information[graph.is_loop]
    for information in spoiled.graph.information[m:]:
        assert np.any(np.all(lenders == information, axis=(1, 2)))


@pytest.mark.parametrize("kind", FALSE_LOOP_KINDS)
def test_the_seed_decides(kind):
    graph = random_graph(2, nodes=50)
    first, second, other = (add_false_loops(graph, kind, 40, seed).graph for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.edges, second.edges)
    np.testing.assert_array_equal(first.measurements, second.measurements)
    assert not np.array_equal(first.edges, other.edges)


def test_groups_confirm_each_other():
    graph = random_graph(3, nodes=80)
    spoiled = add_false_loops(graph, "random-groups", 25, seed=0).graph
    edges, measured = spoiled.edges[-25:], spoiled.measurements[-25:]
    for first in (0, 10, 20):
        rows = slice(first, first + 10)
        assert np.all(np.diff(edges[rows], axis=0) == 1)
        assert np.all(measured[rows] == measured[first])
    assert not np.array_equal(measured[0], measured[10])


@pytest.mark.parametrize("kind", ["random", "local"])
def test_every_pair_that_may_be_drawn_is(kind):
    graph = random_graph(4, nodes=7)
    pairs = {tuple(edge) for edge in add_false_loops(graph, kind, 2000, seed=1).graph.edges[-2000:].tolist()}
    assert pairs == {(i, j) for i in range(7) for j in range(i + 2, 7)}


def test_measurements_claim_the_same_place():
    graph = random_graph(5, nodes=50)
    measured = add_false_loops(graph, "random", 4000, seed=2).graph.measurements[-4000:]
    np.testing.assert_allclose(measured.std(axis=0), [0.3, 0.3, np.radians(10.0)], rtol=0.05)
    np.testing.assert_allclose(measured.mean(axis=0), 0.0, atol=0.02)


def test_a_graph_without_loops_lends_its_odometry():
    graph = random_graph(6, loops=0)
    information = add_false_loops(graph, "random", 5, seed=0).graph.information[-5:]
    assert all(np.any(np.all(graph.information == one, axis=(1, 2))) for one in information)


def test_what_cannot_be_added():
    graph = random_graph(7)
    with pytest.raises(MapmendError, match="false loops must be one of random, local, "):
        add_false_loops(graph, "grouped", 5, seed=0)
    with pytest.raises(MapmendError, match="must not be negative, got -1"):
        add_false_loops(graph, "random", -1, seed=0)
    with pytest.raises(MapmendError, match="no room for random-groups loops in a graph of 11 nodes"):
        add_false_loops(random_graph(7, nodes=11), "random-groups", 5, seed=0)
    with pytest.raises(MapmendError, match="no room for local loops"):
        add_false_loops(random_graph(7, nodes=2, loops=0), "local", 5, seed=0)
    bare = replace(
        graph,
        edges=graph.edges[:0],
        measurements=graph.measurements[:0],
        information=graph.information[:0],
        is_loop=graph.is_loop[:0],
    )
    with pytest.raises(MapmendError, match="no room for random loops in a graph of 12 nodes and 0 edges"):
        add_false_loops(bare, "random", 5, seed=0)
