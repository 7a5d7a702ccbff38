"""Loops that confirm each other, and their use in graduated non-convexity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.geometry import se2
from mapmend.graph import gnc
from mapmend.graph.agreement import REACH_STEPS, confirmed_loops
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import TRUE_EDGE_CHI2, kernel_of
from mapmend.graph.starts import along_odometry
from mapmend.lab.false_loops import add_false_loops
from tests.graph.graphs import random_graph
from tests.reference import graph_agreement


def rounds(seed: int, laps: int = 4, nodes_a_lap: int = 50, turn_std: float = 0.02) -> PoseGraph:
    """At its odometry, a robot that goes round and round and measures at every other node where it was a lap before."""
    generator = np.random.default_rng(seed)
    count = laps * nodes_a_lap
    angles = 2.0 * np.pi * np.arange(count) / nodes_a_lap
    truth = np.column_stack((8.0 * np.cos(angles), 8.0 * np.sin(angles), se2.wrap_angle(angles + np.pi / 2.0)))
    chain = np.stack((np.arange(count - 1), np.arange(1, count)), axis=1)
    again = np.arange(nodes_a_lap, count, 2)
    edges = np.concatenate(
        (chain, np.stack((again - nodes_a_lap + generator.integers(0, 2, len(again)), again), axis=1))
    )
    information = np.broadcast_to(np.diag([400.0, 400.0, turn_std**-2]), (len(edges), 3, 3)).copy()
    noise = generator.normal(size=(len(edges), 3)) * [0.05, 0.05, turn_std]
    measurements = se2.compose(se2.between(truth[edges[:, 0]], truth[edges[:, 1]]), noise)
    graph = PoseGraph(truth, np.arange(count), edges, measurements, information, np.arange(len(edges)) >= count - 1)
    return graph.with_poses(along_odometry(graph))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1.0, 8.0]))
def test_the_kernel_is_its_plain_twin(seed, noise):
    graph = random_graph(seed, nodes=14, loops=12, noise=noise)
    turned = np.random.default_rng(seed).random(len(graph.edges)) < 0.3  # odometry backwards, too
    measurements, information = graph.measurements.copy(), graph.information.copy()
    carry = se2.adjoint(measurements[turned])
    covariances = carry @ np.linalg.inv(information[turned]) @ np.swapaxes(carry, 1, 2)
    information[turned] = np.linalg.inv(0.5 * (covariances + np.swapaxes(covariances, 1, 2)))
    measurements[turned] = se2.inverse(measurements[turned])
    edges = np.where(turned[:, None], graph.edges[:, ::-1], graph.edges)
    graph = replace(graph, edges=edges, measurements=measurements, information=information)
    found = confirmed_loops(graph, graph.information, graph.is_loop)
    np.testing.assert_array_equal(found, graph_agreement.confirmed(graph, REACH_STEPS, TRUE_EDGE_CHI2))


def test_true_loops_confirm_each_other_and_random_false_ones_do_not():
    spoiled = add_false_loops(rounds(0), "random", 100, seed=0)
    found = confirmed_loops(spoiled.graph, spoiled.graph.information, spoiled.graph.is_loop)
    true = spoiled.graph.is_loop & ~spoiled.is_false
    assert np.mean(found[true]) > 0.95
    assert np.mean(found[spoiled.is_false]) < 0.2
    assert not np.any(found[~spoiled.graph.is_loop])


def test_without_a_chain_of_trusted_edges_no_loop_is_confirmed():
    graph = rounds(0)
    assert not confirmed_loops(graph, graph.information, np.ones_like(graph.is_loop)).any()
    pairs = graph.edges.copy()
    pairs[20] = (19, 21)
    broken = replace(graph, edges=pairs)
    assert not confirmed_loops(broken, graph.information, graph.is_loop).any()


def test_by_its_own_information_a_loop_agrees_or_not():
    graph = random_graph(3, nodes=30, loops=2, noise=0.0)
    edges = graph.edges.copy()
    edges[-2:] = [[3, 20], [5, 22]]
    seen = se2.between(graph.poses[edges[:, 0]], graph.poses[edges[:, 1]])
    seen[-1, 0] += 2.0
    graph = replace(graph, edges=edges, measurements=seen)
    for scale, agrees in ((1.0, False), (1e-4, True)):
        assert confirmed_loops(graph, graph.information * scale, graph.is_loop)[-2:].tolist() == [agrees] * 2


def test_gnc_holds_where_random_false_loops_outnumber_the_true_ones(monkeypatch):
    graph = rounds(1, laps=3, nodes_a_lap=100, turn_std=0.1)
    truth = optimize(graph).poses
    for seed in range(3):
        spoiled = add_false_loops(graph, "random", 300, seed=seed).graph
        result = optimize(spoiled, kernel=kernel_of("gnc"))
        assert np.abs(result.poses - truth)[:, :2].max() < 0.6
        with monkeypatch.context() as one_way:
            one_way.setattr(gnc, "confirmed_loops", lambda graph, information, doubted: np.zeros_like(doubted))
            alone = optimize(spoiled, kernel=kernel_of("gnc"))
        assert np.abs(alone.poses - truth)[:, :2].max() > 5.0
        assert result.cost_final < alone.cost_final
