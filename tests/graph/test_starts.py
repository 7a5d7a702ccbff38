"""Where the optimizer starts: noiseless graphs are found exactly, and the rotations come from the right equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.starts import STARTS, starting_poses
from mapmend.graph.system import System
from tests.graph.graphs import consistent, perturbed, random_graph, read_public_graph

several = settings(max_examples=15, deadline=None)
seeds = st.integers(0, 10_000)
fixed_nodes = st.sampled_from([(0,), (5,), (11,), (2, 3, 9)])


def select(graph: PoseGraph, rows) -> PoseGraph:
    """The graph with those edges only, in that order."""
    names = ("edges", "measurements", "information", "is_loop")
    return replace(graph, **{name: getattr(graph, name)[rows] for name in names})


def turned_round(graph: PoseGraph, rows) -> PoseGraph:
    """The same graph, some of its edges measured from their other end."""
    edges, measurements = graph.edges.copy(), graph.measurements.copy()
    edges[rows] = edges[rows, ::-1]
    measurements[rows] = se2.inverse(measurements[rows])
    return replace(graph, edges=edges, measurements=measurements)


def assert_same_poses(got, expected, tolerance=1e-9):
    difference = got - expected
    difference[:, 2] = se2.wrap_angle(difference[:, 2])
    np.testing.assert_allclose(difference, 0.0, atol=tolerance)


@several
@given(seeds, fixed_nodes, st.sampled_from(STARTS[1:]))
def test_a_graph_without_noise_is_found_from_anywhere(seed, fixed, start):
    truth = turned_round(consistent(random_graph(seed)), np.arange(3, 18, 2))
    graph = replace(perturbed(truth, seed, 5.0), fixed=fixed)
    graph.poses[list(fixed)] = truth.poses[list(fixed)]
    assert_same_poses(starting_poses(graph, start), truth.poses)


@several
@given(seeds, fixed_nodes)
def test_rotations_first_against_dense_least_squares(seed, fixed):
    graph = replace(perturbed(random_graph(seed), seed, 0.5), fixed=fixed)
    n, (i, j) = len(graph), graph.edges.T
    weights = 1.0 / np.linalg.inv(graph.information)[:, 2, 2]
    equations = np.zeros((len(i), n), dtype=complex)
    equations[np.arange(len(i)), j] = 1.0
    equations[np.arange(len(i)), i] = -np.exp(1j * graph.measurements[:, 2])
    equations *= np.sqrt(weights)[:, None]
    free, known = np.setdiff1d(np.arange(n), fixed), np.exp(1j * graph.poses[list(fixed), 2])
    points = np.linalg.lstsq(equations[:, free], -equations[:, list(fixed)] @ known)[0]
    got = starting_poses(graph, "chordal")
    np.testing.assert_allclose(se2.wrap_angle(got[free, 2] - np.angle(points)), 0.0, atol=1e-8)

    # With those rotations, no other translations have less chi2.
    def chi2_at(translations):
        poses = np.column_stack((translations, got[:, 2]))
        errors = se2.between(graph.measurements, se2.between(poses[i], poses[j]))
        xy = graph.information.copy()
        xy[:, 2], xy[:, :, 2] = 0.0, 0.0
        return np.einsum("mi,mij,mj->", errors, xy, errors)

    least = chi2_at(got[:, :2])
    moves = np.random.default_rng(seed).normal(size=(20, n, 2))
    moves[:, list(fixed)] = 0.0
    assert all(chi2_at(got[:, :2] + 1e-3 * move) > least for move in moves)
    np.testing.assert_array_equal(got[list(fixed)], graph.poses[list(fixed)])


def test_the_tree_takes_the_best_edges():
    graph = random_graph(2, nodes=6, loops=0)
    detour = np.array([[0, 3], [3, 5], [5, 0]])
    edges = np.concatenate((graph.edges, detour))
    seen = se2.between(graph.poses[edges[:, 0]], graph.poses[edges[:, 1]])
    information = np.concatenate((graph.information, [1e4 * np.eye(3), 1e6 * np.eye(3), 1.0 * np.eye(3)]))
    measurements = se2.compose(seen, np.random.default_rng(0).normal(scale=0.1, size=seen.shape))
    graph = replace(graph, edges=edges, measurements=measurements, information=information, is_loop=np.arange(8) >= 5)
    poses = starting_poses(graph, "tree")
    errors = np.abs(se2.between(measurements, se2.between(poses[edges[:, 0]], poses[edges[:, 1]]))).max(axis=1)
    # Five edges hold six nodes; the weakest of each circle are left out.
    assert set(np.flatnonzero(errors < 1e-12)) >= {5, 6}
    assert (errors < 1e-12).sum() == 5
    assert errors[7] > 1e-3


def test_the_odometry_goes_before_loops_that_are_as_good():
    graph = random_graph(4, nodes=30, loops=40)
    graph = replace(graph, information=np.broadcast_to(np.eye(3), graph.information.shape).copy())
    order = np.random.default_rng(0).permutation(len(graph.edges))
    tree = starting_poses(select(graph, order), "tree")
    assert_same_poses(tree, starting_poses(graph, "odometry"))


def test_a_graph_without_odometry_says_so():
    graph = random_graph(0, loops=0)
    graph.edges[6] = 5, 7
    with pytest.raises(MapmendError, match=r"no edge joins node 67 to the next, 77: .* start along a tree"):
        starting_poses(graph, "odometry")


def test_starts_that_there_are_not_and_graphs_that_hang_loose():
    with pytest.raises(MapmendError, match="the start must be one of given, odometry, tree, chordal, got 'best'"):
        starting_poses(random_graph(0), "best")
    loose = select(random_graph(0, loops=0), np.arange(11) != 6)
    for start in STARTS[2:]:
        with pytest.raises(MapmendError, match="no chain of edges joins node 77"):
            starting_poses(loose, start)


def test_the_given_start_is_a_copy():
    graph = random_graph(0)
    given_poses = starting_poses(graph, "given")
    np.testing.assert_array_equal(given_poses, graph.poses)
    assert given_poses is not graph.poses


def test_m3500a_ends_in_its_best_known_optimum_from_rotations_first():
    """From its odometry it ends at some 7,000. GTSAM stays in the same optimum (``test_gtsam``)."""
    graph = read_public_graph("M3500a")
    system = System(graph)
    result = optimize(graph.with_poses(starting_poses(graph, "chordal", system)), system=system)
    assert result.converged
    assert result.iterations <= 6
    assert result.chi2_final == pytest.approx(912.115, abs=1e-3)
