"""The normal equations: Jacobians, assembly, factorization."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_matrix

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.system import Linearization, System
from tests.graph.graphs import perturbed, random_graph
from tests.reference import graph_linearization as reference

coordinates = st.floats(-20.0, 20.0)
angles = st.floats(-3.1, 3.1)
poses = st.tuples(coordinates, coordinates, angles).map(np.array)


def dense(system: System, linearization: Linearization) -> np.ndarray:
    shape = (system.size, system.size)
    upper = csc_matrix((linearization.values, system.row_indices, system.column_starts), shape=shape).toarray()
    return upper + np.triu(upper, 1).T


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


def test_the_pattern_is_a_sorted_upper_triangle():
    system = System(random_graph(1))
    for column in range(system.size):
        rows = system.row_indices[system.column_starts[column] : system.column_starts[column + 1]]
        assert np.all(np.diff(rows) > 0)
        assert rows[-1] == column


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


def test_a_factorization_is_the_one_that_it_says():
    graph = random_graph(3)
    system, linearization = linearized(graph)
    f = system.factorize(linearization.values)
    lower = csc_matrix((f.lower, f.rows, f.starts), shape=(system.size, system.size)).toarray() + np.eye(system.size)
    H = dense(system, linearization)
    np.testing.assert_allclose(lower * f.diagonal @ lower.T, H[np.ix_(f.order, f.order)], atol=1e-11 * np.abs(H).max())
    assert all(np.all(np.diff(f.rows[a:b]) > 0) for a, b in zip(f.starts[:-1], f.starts[1:], strict=True))


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
    assert np.all(system.factorize(values).diagonal > 0.0)
