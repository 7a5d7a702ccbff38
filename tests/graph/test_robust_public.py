"""Public graphs from odometry, with their own false loops or added ones."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.graph.optimizer import optimize
from mapmend.graph.robust import distrusted, kernel_of
from mapmend.graph.starts import along_odometry
from mapmend.lab.false_loops import FALSE_LOOP_KINDS, add_false_loops
from tests.graph.graphs import read_public_graph
from tests.real_data import data_path


def at_odometry(name):
    graph = read_public_graph(name)
    return graph.with_poses(along_odometry(graph))


def error_m(poses, truth):
    stamps = np.arange(len(poses), dtype=np.float64)
    return trajectory_errors(stamps, poses, stamps, truth).translation_rmse_m


@pytest.mark.parametrize("kernel", ["geman-mcclure", "switchable", "cauchy"])
def test_bicocca_without_a_threshold_comes_within_a_metre_of_the_truth(kernel):
    graph = at_odometry("bicocca25b_0.000")
    with gzip.open(data_path("posegraphs/bicocca25b.stamps.txt.gz")) as lines:
        stamps = np.loadtxt(lines)
    with gzip.open(data_path("posegraphs/bicocca25b.groundtruth.csv.gz")) as lines:
        truth = np.loadtxt(lines, delimiter=",")
    poses = optimize(graph, kernel=kernel_of(kernel)).poses
    assert trajectory_errors(stamps, poses, truth[:, 0], truth[:, 1:]).translation_rmse_m < 1.1


@pytest.mark.parametrize("kind", FALSE_LOOP_KINDS)
def test_a_hundred_false_loops_do_no_harm_to_m3500(kind):
    graph = at_odometry("M3500")
    optimum = optimize(graph).poses
    spoiled = add_false_loops(graph, kind, 100, seed=0)
    result = optimize(spoiled.graph, kernel=kernel_of("gnc"))
    found = np.zeros(len(spoiled.is_false), dtype=np.bool_)
    found[distrusted(result.edge_weights)] = True
    assert error_m(result.poses, optimum) < 0.01
    # Some false loops are true by chance.
    assert np.sum(found & spoiled.is_false) >= 95
    assert not np.any(found & ~spoiled.is_false)
