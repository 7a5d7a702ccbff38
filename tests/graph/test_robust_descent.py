"""Optimization with kernels: against finite differences and dense algebra, and robustness against false loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph import _robust_kernels
from mapmend.graph.optimizer import OptimizerSettings, edge_chi2, edge_errors, optimize
from mapmend.graph.robust import KERNELS, Switchable, distrusted, kernel_of
from mapmend.graph.robust_descent import KernelDescent, SwitchDescent
from mapmend.graph.system import System
from mapmend.lab.false_loops import add_false_loops
from tests.graph.graphs import perturbed, random_graph
from tests.reference import graph_linearization as reference

TIGHT = OptimizerSettings(tolerance_sigma=1e-7, tolerance_share=1e-15, max_iterations=500)
SMOOTH = [name for name in KERNELS if name not in ("gnc", "max-mixture")]
REDESCENDING = ["geman-mcclure", "dcs", "switchable", "gnc"]
seeds = st.integers(0, 10_000)
several = settings(max_examples=10, deadline=None)


def robust_cost(graph, kernel):
    chi2 = edge_chi2(graph)
    return chi2[~graph.is_loop].sum() + kernel.cost(chi2[graph.is_loop]).sum()


@several
@given(seeds)
def test_errors_of_the_kernel_are_those_of_the_definition(seed):
    graph = perturbed(random_graph(seed), seed, 0.5)
    errors, chi2 = _robust_kernels.edge_errors(graph.poses, graph.edges, graph.measurements, graph.information)
    for k, (i, j) in enumerate(graph.edges):
        expected = reference.error(graph.poses[i], graph.poses[j], graph.measurements[k])
        np.testing.assert_allclose(errors[k], expected, atol=1e-12)
        assert chi2[k] == pytest.approx(expected @ graph.information[k] @ expected)
    np.testing.assert_allclose(edge_errors(graph), errors, atol=1e-12)


@several
@given(seeds, st.sampled_from(SMOOTH))
def test_nothing_is_downhill_from_the_optimum(seed, name):
    graph = random_graph(seed, noise=2.0)
    kernel = kernel_of(name, 2.0)
    result = optimize(graph, TIGHT, kernel=kernel)
    here = robust_cost(graph.with_poses(result.poses), kernel)
    assert result.cost_final == pytest.approx(here, rel=1e-6)
    assert result.cost_final <= result.cost_initial
    assert result.chi2_final == pytest.approx(edge_chi2(graph.with_poses(result.poses)).sum())
    generator = np.random.default_rng(seed)
    for _ in range(10):
        motion = generator.normal(scale=1e-3, size=graph.poses.shape)
        motion[0] = 0.0
        assert robust_cost(graph.with_poses(se2.compose(result.poses, motion)), kernel) >= here - 1e-6 * here


@several
@given(seeds)
def test_eliminated_switches_step_as_in_the_joint_system(seed):
    graph = perturbed(random_graph(seed), seed, 0.1)
    xi, switches = 3.0, np.random.default_rng(seed).uniform(0.2, 1.2, int(graph.is_loop.sum()))
    system = System(graph)
    descent = SwitchDescent(system, graph, graph.information, Switchable(xi), graph.is_loop)
    descent.switches = switches
    descent._begin()
    step, gain = descent.propose(0.0)

    n, loops = len(graph), np.flatnonzero(graph.is_loop)
    H, g = np.zeros((3 * n + len(loops),) * 2), np.zeros(3 * n + len(loops))
    for k, (i, j) in enumerate(graph.edges):
        e = reference.error(graph.poses[i], graph.poses[j], graph.measurements[k])
        root = np.linalg.cholesky(graph.information[k]).T
        J, residual = np.zeros((4, len(g))), np.zeros(4)
        switch = switches[np.searchsorted(loops, k)] if graph.is_loop[k] else 1.0
        by_i, by_j = reference.jacobians(graph.poses[i], graph.poses[j], graph.measurements[k])
        J[:3, 3 * i : 3 * i + 3], J[:3, 3 * j : 3 * j + 3] = switch * root @ by_i, switch * root @ by_j
        residual[:3] = switch * root @ e
        if graph.is_loop[k]:
            place = 3 * n + np.searchsorted(loops, k)
            J[:3, place], J[3, place] = root @ e, -np.sqrt(xi)
            residual[3] = np.sqrt(xi) * (1.0 - switch)
        H += J.T @ J
        g += J.T @ residual
    expected = np.linalg.solve(H[3:, 3:], -g[3:])
    np.testing.assert_allclose(step, expected[: 3 * n - 3], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(descent._switch_steps(step), expected[3 * n - 3 :], rtol=1e-6, atol=1e-9)
    assert gain == pytest.approx(-expected @ g[3:], rel=1e-6)


@pytest.mark.parametrize("name", REDESCENDING)
def test_false_loops_are_found_and_do_no_harm(name):
    clean = random_graph(3, nodes=120, loops=80)
    truth = optimize(clean).poses
    spoiled = add_false_loops(clean, "random", 60, seed=3)
    result = optimize(spoiled.graph, kernel=kernel_of(name))
    assert result.converged
    found = np.zeros(len(spoiled.is_false), dtype=np.bool_)
    found[distrusted(result.edge_weights)] = True
    assert np.mean(found[spoiled.is_false]) > 0.95
    assert np.mean(found[~spoiled.is_false]) < 0.05
    assert np.abs(result.poses - truth)[:, :2].max() < 0.1
    assert np.abs(optimize(spoiled.graph).poses - truth)[:, :2].max() > 1.0


@pytest.mark.parametrize("name", KERNELS)
def test_without_false_loops_the_optimum_stays_about_where_it_was(name):
    graph = random_graph(5, nodes=60, loops=40)
    difference = optimize(graph, kernel=kernel_of(name)).poses - optimize(graph).poses
    # Some standard deviations of a measurement.
    assert np.abs(difference).max() < 0.1


@pytest.mark.parametrize("name", KERNELS)
def test_what_is_not_doubted_keeps_its_weight(name):
    graph = add_false_loops(random_graph(6, nodes=40, loops=20), "random", 10, seed=0).graph
    result = optimize(graph, kernel=kernel_of(name, 0.1))
    assert np.all(result.edge_weights[~graph.is_loop] == 1.0)
    assert result.edge_weights[graph.is_loop].min() < 0.5
    nothing = optimize(graph, kernel=kernel_of(name), doubted=np.zeros_like(graph.is_loop))
    np.testing.assert_array_equal(nothing.poses, optimize(graph).poses)


@pytest.mark.parametrize("name", KERNELS)
def test_a_system_serves_other_kernels_with_the_same_result(name):
    graph = random_graph(7, nodes=40, loops=30, noise=2.0)
    fresh = optimize(graph, kernel=kernel_of(name))
    again = optimize(graph, kernel=kernel_of(name), system=optimize(graph).system)
    np.testing.assert_array_equal(again.poses, fresh.poses)
    np.testing.assert_array_equal(again.edge_weights, fresh.edge_weights)


def test_the_kernel_counts_with_the_weights_given():
    graph = random_graph(8, nodes=40, loops=30, noise=2.0)
    weights = np.random.default_rng(8).uniform(0.5, 2.0, len(graph.edges))
    weighted = replace(graph, information=graph.information * weights[:, None, None])
    kernel = kernel_of("dcs", 1.0)
    got = optimize(graph, kernel=kernel, weights=weights)
    np.testing.assert_array_equal(got.poses, optimize(weighted, kernel=kernel).poses)


def test_another_kernel_at_the_same_poses():
    graph = random_graph(9, noise=2.0)
    descent = KernelDescent(System(graph), graph, graph.information, kernel_of("dcs", 1.0), graph.is_loop)
    descent.use(kernel_of("huber", 1.0))
    assert descent.cost == pytest.approx(robust_cost(graph, kernel_of("huber", 1.0)))
    np.testing.assert_allclose(
        descent.weights()[graph.is_loop], kernel_of("huber", 1.0).weight(edge_chi2(graph)[graph.is_loop])
    )


def test_the_degrees_of_gnc_are_told():
    told = []
    graph = add_false_loops(random_graph(4, nodes=60, loops=40), "random", 20, seed=0).graph
    optimize(graph, kernel=kernel_of("gnc"), progress=lambda stage, done, total: told.append((done, total)))
    done, total = np.array(told).T
    assert np.all(np.diff(done) > 0)
    assert done[-1] == total[0]
    assert np.all(total == total[0])


def test_steps_stay_within_their_limit():
    graph = add_false_loops(random_graph(4, nodes=60, loops=40), "random", 20, seed=0).graph
    still = optimize(graph, OptimizerSettings(max_iterations=0), kernel=kernel_of("gnc"))
    np.testing.assert_array_equal(still.poses, graph.poses)
    assert (still.iterations, still.converged) == (0, False)
    for name in set(KERNELS) - {"gnc"}:
        assert optimize(graph, OptimizerSettings(max_iterations=2), kernel=kernel_of(name)).iterations == 2


def test_doubted_edges_that_cannot_be():
    graph = random_graph(0)
    for doubted in (np.ones(3, np.bool_), np.ones(len(graph.edges))):
        with pytest.raises(MapmendError, match="doubted must be bool of shape"):
            optimize(graph, kernel=kernel_of("dcs"), doubted=doubted)
