"""The normal equations: Jacobians, assembly, factorization."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph import elimination as elimination_of_graphs
from mapmend.graph.marginals import marginals
from mapmend.graph.system import Linearization, System
from tests.graph.graphs import grid_graph, perturbed, random_graph
from tests.reference import graph_elimination as elimination
from tests.reference import graph_linearization as reference

coordinates = st.floats(-20.0, 20.0)
angles = st.floats(-3.1, 3.1)
poses = st.tuples(coordinates, coordinates, angles).map(np.array)


def rows_in_place(system: System) -> np.ndarray:
    """Which unknown comes when."""
    return (3 * system.elimination.order[:, None] + np.arange(3)).ravel()


def dense(system: System, linearization: Linearization) -> np.ndarray:
    H, rows = np.zeros((system.size, system.size)), rows_in_place(system)
    H[np.ix_(rows, rows)] = elimination.dense_values(system.elimination.fronts, linearization.values)
    return H


def linearized(graph):
    system = System(graph)
    return system, system.linearize(graph.poses, graph.measurements, graph.information)


@given(poses, poses, poses)
def test_jacobians_are_the_derivatives(pose_i, pose_j, measurement):
    step = 1e-6
    analytic = reference.jacobians(pose_i, pose_j, measurement)
    for axis in range(3):
        move = step * np.eye(3)[axis]
        for end in range(2):
            ahead, behind = [pose_i, pose_j], [pose_i, pose_j]
            ahead[end] = se2.compose(ahead[end], move)
            behind[end] = se2.compose(behind[end], -move)
            difference = reference.error(*ahead, measurement) - reference.error(*behind, measurement)
            difference[2] = se2.wrap_angle(difference[2])
            np.testing.assert_allclose(analytic[end][:, axis], difference / (2 * step), atol=1e-7)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([(0,), (3,), (11,), (2, 3, 9)]))
def test_the_kernel_agrees_with_its_plain_twin(seed, fixed):
    graph = replace(perturbed(random_graph(seed), seed, 0.5), fixed=fixed)
    system, ours = linearized(graph)
    chi2, H, gradient = reference.dense_system(graph)
    rows = reference.free_rows(graph)
    assert ours.chi2 == pytest.approx(chi2, rel=1e-12)
    np.testing.assert_allclose(dense(system, ours), H[np.ix_(rows, rows)], rtol=1e-10, atol=1e-12 * np.abs(H).max())
    np.testing.assert_allclose(ours.gradient, gradient[rows], rtol=1e-9, atol=1e-12 * np.abs(gradient).max())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_a_motion_is_a_composition(seed):
    graph = replace(random_graph(seed), fixed=(2, 5))
    system = System(graph)
    step = np.random.default_rng(seed).normal(scale=3.0, size=system.size)
    expected = graph.poses.copy()
    expected[system.nodes] = se2.compose(graph.poses[system.nodes], step.reshape(-1, 3))
    np.testing.assert_allclose(system.move(graph.poses, step), expected, atol=1e-14)


def test_read_only_and_strided_arrays_are_taken():
    graph = random_graph(4)
    _, expected = linearized(graph)
    graph.poses.setflags(write=False)
    strided = np.repeat(graph.measurements, 2, axis=0)[::2]
    _, got = linearized(replace(graph, measurements=strided))
    np.testing.assert_array_equal(got.values, expected.values)


def test_a_factorization_solves_and_outlives_the_next():
    graph = random_graph(2)
    system, linearization = linearized(graph)
    H = dense(system, linearization)
    right_sides = np.random.default_rng(0).normal(size=(system.size, 2))
    factorization = system.factorize(linearization.values)
    system.factorize(3.0 * linearization.values)
    np.testing.assert_allclose(factorization.solve(right_sides), np.linalg.solve(H, right_sides), rtol=1e-8)
    np.testing.assert_allclose(factorization.solve(right_sides[:, 0]), np.linalg.solve(H, right_sides[:, 0]), rtol=1e-8)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 60), st.integers(0, 60))
def test_the_factor_is_that_of_cholesky(seed, nodes, loops):
    system, linearization = linearized(perturbed(random_graph(seed, nodes, loops), seed, 0.3))
    H, rows = dense(system, linearization), rows_in_place(system)
    lower = elimination.dense_lower(system.elimination.fronts, system.factorize(linearization.values).lower)
    expected = np.linalg.cholesky(H[np.ix_(rows, rows)])
    np.testing.assert_allclose(lower, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 60), st.integers(0, 60), st.integers(2, 4))
def test_threads_change_no_number(seed, nodes, loops, threads):
    graph = perturbed(random_graph(seed, nodes, loops), seed, 0.3)
    with mock.patch.object(elimination_of_graphs, "WORTH_THREADS", 0.0):
        one, several = System(graph), System(graph, threads)
        assert not len(one.elimination.subtrees)
        values = one.linearize(graph.poses, graph.measurements, graph.information).values
        alone, together = one.factorize(values), several.factorize(values)
    np.testing.assert_array_equal(together.lower, alone.lower)
    np.testing.assert_array_equal(marginals(together), marginals(alone))


def test_a_large_graph_is_factorized_side_by_side_and_a_weak_pivot_is_found_there():
    graph = grid_graph(80)
    system, alone = System(graph, 2), System(graph)
    assert len(system.elimination.subtrees) > 2
    values = system.linearize(graph.poses, graph.measurements, graph.information).values
    np.testing.assert_array_equal(system.factorize(values).lower, alone.factorize(values).lower)
    values[: 9 * system.size // 3] *= 1e-3
    for one in (system, alone):
        with pytest.raises(MapmendError, match=r"nothing holds node \d+"):
            one.factorize(values)


def test_memory_that_is_taken_again_leaves_no_trace():
    graph = random_graph(7)
    system, expected = linearized(graph)
    elsewhere = perturbed(graph, 7, 1.0)
    old = system.linearize(elsewhere.poses, graph.measurements, graph.information)
    again = system.linearize(graph.poses, graph.measurements, graph.information, old)
    assert again.values is old.values
    np.testing.assert_array_equal(again.values, expected.values)
    step = system.solve(expected.values, expected.gradient)
    system.solve(2.0 * expected.values, expected.gradient)
    np.testing.assert_array_equal(system.solve(expected.values, expected.gradient), step)
    np.testing.assert_array_equal(system.factorize(expected.values).solve(expected.gradient), step)


def test_damping_scales_the_diagonal():
    graph = random_graph(5)
    system, linearization = linearized(graph)
    H = dense(system, linearization)
    damped = H + 0.5 * np.diag(np.diag(H))
    b = np.arange(float(system.size))
    np.testing.assert_allclose(system.factorize(linearization.values, 0.5).solve(b), np.linalg.solve(damped, b))


def test_an_edge_without_weight_is_refused_when_all_hangs_on_it():
    graph = random_graph(6, nodes=5, loops=0)
    system = System(graph)
    information = graph.information.copy()
    information[2] = 0.0
    values = system.linearize(graph.poses, graph.measurements, information).values
    with pytest.raises(MapmendError, match="singular"):
        system.factorize(values)
    information[2] = 1e-16 * graph.information[2]
    values = system.linearize(graph.poses, graph.measurements, information).values
    with pytest.raises(MapmendError, match=r"nothing holds node \d+"):
        system.factorize(values)
    information[2] = graph.information[2]
    values = system.linearize(graph.poses, graph.measurements, information).values
    assert np.all(np.isfinite(system.factorize(values).lower))
