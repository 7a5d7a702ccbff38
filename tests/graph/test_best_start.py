"""Which start is tried when, and which end is kept."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.best_start import INITS, TRIAL_STEPS, looks_poor, optimize_from
from mapmend.graph.optimizer import OptimizerSettings, edge_chi2, optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import kernel_of
from mapmend.io.g2o import read_g2o, write_g2o
from mapmend.lab.false_loops import add_false_loops
from mapmend.lab.graph_noise import with_angle_noise
from tests.graph.graphs import grid_graph, perturbed, random_graph, read_public_graph


def wound_ring(nodes: int = 40) -> PoseGraph:
    """A ring whose poses turn twice where its edges turn once: a local minimum with every edge strained alike."""
    edges = np.stack((np.arange(nodes), (np.arange(nodes) + 1) % nodes), axis=1)
    measurements = np.tile([1.0, 0.0, 2.0 * np.pi / nodes], (nodes, 1))
    information = np.tile(np.diag([400.0, 400.0, 400.0]), (nodes, 1, 1))
    poses = np.zeros((nodes, 3))
    for k in range(1, nodes):
        poses[k] = se2.compose(poses[k - 1], [1.0, 0.0, 4.0 * np.pi / nodes])
    return PoseGraph(poses, np.arange(nodes), edges, measurements, information, np.arange(nodes) == nodes - 1)


def test_a_good_end_is_not_tried_again():
    graph = perturbed(random_graph(1, nodes=40, loops=30), 1, 0.02)
    found = optimize_from(graph)
    assert (found.taken, [end.start for end in found.ends]) == ("given", ["given"])
    np.testing.assert_array_equal(found.result.poses, optimize(graph).poses)


def test_the_chordal_start_saves_a_ring_that_is_wound_twice():
    graph = wound_ring()
    stuck = optimize(graph)
    assert stuck.converged
    assert stuck.chi2_final > 100.0
    found = optimize_from(graph)
    assert found.taken == "chordal"
    assert [end.chi2 for end in found.ends] == [stuck.chi2_final, found.result.chi2_final]
    assert found.result.chi2_final < 1e-6


@pytest.mark.parametrize("kernel", ["dcs", "cauchy"])
def test_with_a_kernel_its_cost_decides(kernel):
    """chi2 counts a false loop in full, so the end that rejects it has the larger chi2 and the lower cost."""
    graph = random_graph(3, nodes=40, loops=30)
    graph.measurements[-1] += (30.0, -20.0, 2.0)
    found = optimize_from(graph, kernel=kernel_of(kernel))
    assert len(found.ends) == 2
    best = min(found.ends, key=lambda end: end.cost)
    assert found.result.cost_final <= best.cost * (1.0 + 1e-6)
    assert found.result.cost_final < 0.5 * edge_chi2(graph.with_poses(optimize(graph).poses)).sum()


def test_the_first_end_is_kept_where_both_are_the_same():
    graph = random_graph(3, nodes=40, loops=30, noise=5.0)
    found = optimize_from(graph)
    assert len(found.ends) == 2
    assert found.taken == "given"
    np.testing.assert_array_equal(found.result.poses, optimize(graph).poses)


def test_true_graphs_look_good_and_strained_ones_poor():
    """Of 40 graphs with noise as stated, two tests with one false alarm in a hundred each let few look poor."""
    poor = 0
    for seed in range(40):
        graph = random_graph(seed, nodes=30, loops=30)
        poor += looks_poor(graph, optimize(graph))
    assert poor <= 4  # 0.8 expected; five or more have a chance below 0.002
    graph = random_graph(0, nodes=30, loops=30)
    graph.measurements[-1, 0] += 3.0  # one edge of 59, with covariances so wide that their sum alone says nothing
    graph = replace(graph, information=graph.information / 100.0)
    result = optimize(graph)
    assert result.chi2_final < 3 * (len(graph.edges) - len(graph) + 1)
    assert looks_poor(graph, result)


def test_what_has_not_converged_is_tried_again():
    graph = perturbed(random_graph(1, nodes=40, loops=30), 1, 0.5)
    found = optimize_from(graph, settings=OptimizerSettings(max_iterations=1))
    assert [end.converged for end in found.ends] == [False, False]


def test_a_graph_without_loops_or_without_edges_is_good():
    assert not looks_poor(random_graph(0, loops=0), optimize(random_graph(0, loops=0)))
    alone = PoseGraph(
        np.zeros((1, 3)),
        np.zeros(1, np.int64),
        np.zeros((0, 2), np.int64),
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        np.zeros(0, np.bool_),
    )
    assert optimize_from(alone).taken == "given"


def test_other_starts_are_refused():
    with pytest.raises(MapmendError, match="the start must be one of auto, given, odometry, tree, chordal"):
        optimize_from(random_graph(0), "best")


@pytest.mark.parametrize("init", INITS[1:])
def test_a_start_that_is_asked_for_is_the_only_one(init):
    found = optimize_from(wound_ring(), init)
    assert ([end.start for end in found.ends], found.taken) == ([init], init)


@pytest.mark.parametrize("seed", range(3))
def test_a_grid_with_noise_ends_as_low_as_the_chordal_start(seed):
    truth = grid_graph(20)
    stated = np.tile(np.diag([400.0, 400.0, 100.0]), (len(truth.edges), 1, 1))
    graph = with_angle_noise(replace(truth, information=stated), 0.1, seed, "tree")
    chordal = optimize_from(graph, "chordal").result.chi2_final
    assert optimize_from(graph).result.chi2_final <= chordal * (1.0 + 1e-6)


def test_m3500a_ends_in_its_best_known_optimum():
    found = optimize_from(read_public_graph("M3500a"))
    assert found.taken == "chordal"
    assert found.ends[0].chi2 > 6000.0
    assert found.result.chi2_final == pytest.approx(912.115, abs=1e-3)


def test_m3500_with_more_noise_ends_lower_than_from_its_odometry():
    graph = with_angle_noise(read_public_graph("M3500"), 0.1, 1)
    found = optimize_from(graph)
    assert found.taken == "chordal"
    assert found.result.chi2_final < 0.1 * found.ends[0].chi2


@pytest.mark.parametrize("seed", range(3))
def test_covariances_stated_too_wide_hide_no_poor_end(seed):
    """Ten times the standard deviations: chi2 lies far below its degrees of freedom even at a wrong optimum."""
    graph = with_angle_noise(read_public_graph("M3500"), 0.2, seed)
    graph = replace(graph, information=0.01 * graph.information)
    found = optimize_from(graph)
    assert found.ends[0].chi2 < 3 * (len(graph.edges) - len(graph) + 1)
    assert found.taken == "chordal"


def test_a_second_start_without_promise_is_given_up():
    graph = add_false_loops(read_public_graph("M3500"), "random", 100, seed=0).graph
    found = optimize_from(graph, kernel=kernel_of("dcs"))
    assert found.taken == "given"
    assert found.ends[1].given_up
    assert found.ends[1].iterations == TRIAL_STEPS


def test_the_command_takes_the_better_start_and_says_so(mapmend, tmp_path):
    write_g2o(tmp_path / "in.g2o", wound_ring())
    arguments = ("optimize", tmp_path / "in.g2o", "-o", tmp_path / "out.g2o")
    values = json.loads(mapmend(*arguments, "--json").out)
    assert values["init"] == "chordal"
    assert [end["start"] for end in values["ends"]] == ["given", "chordal"]
    assert edge_chi2(read_g2o(tmp_path / "out.g2o")).sum() == pytest.approx(values["chi2_final"], abs=1e-6)
    said = f"start: chordal, the better of 2: from given chi2 {values['ends'][0]['chi2']:.3f}; from chordal chi2 "
    assert said in mapmend(*arguments).out
    assert "cost" in mapmend(*arguments, "--kernel", "dcs").out
    assert json.loads(mapmend(*arguments, "--init", "given", "--json").out)["init"] == "given"
