"""``mapmend map --robust auto``: a false loop of the front end is switched off because the scans contradict it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mapmend import slam
from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.io.reader import read_run


@pytest.fixture(scope="module")
def built(simulation):
    """The front end's graph of the short log, with two false loops and a true one."""
    made = slam.graph_optimization(simulation.log, Config())
    graph = made.graph
    far = len(graph) - 3
    edges = np.array([(2, far), (3, far - 1), (1, far - 2)], dtype=np.int64)
    measured = se2.between(graph.poses[edges[:, 0]], graph.poses[edges[:, 1]])
    measured[:2, :2] += (0.5, 0.4)
    spoiled = replace(
        graph,
        edges=np.concatenate((graph.edges, edges)),
        measurements=np.concatenate((graph.measurements, measured)),
        information=np.concatenate((graph.information, np.tile(np.diag((400.0, 400.0, 2500.0)), (3, 1, 1)))),
        is_loop=np.concatenate((graph.is_loop, np.ones(3, np.bool_))),
    )
    return replace(made, graph=spoiled)


def test_the_scans_go_where_their_nodes_go(built):
    again, result = slam.tuned(built, Config(), 2, slam.no_progress)
    assert result.consistent
    assert {len(built.graph.edges) - 3, len(built.graph.edges) - 2} <= set(result.switched_off)
    np.testing.assert_array_equal(again.graph.poses, result.graph.poses)
    off = np.hypot(*(again.scan_poses - built.scan_poses)[:, :2].T)
    moved = np.hypot(*(again.graph.poses - built.graph.poses)[:, :2].T)
    assert off.max() < 0.1
    assert off.max() <= 1.5 * moved.max() + 1e-9


def test_without_loops_there_is_nothing_to_tune(built):
    chain = replace(built.graph, is_loop=np.zeros(len(built.graph.edges), np.bool_))
    assert slam.tuned(replace(built, graph=chain), Config(), 1, slam.no_progress)[1] is None


def test_the_run_tells_of_it(mapmend, log_path, tmp_path):
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--robust", "auto", "--json")
    assert answer.code == 0
    page = json.loads(answer.out)
    assert page["configuration"]["loops"]["tune"] is True
    _, graph = read_run(tmp_path / "run")
    assert (page["tuning"] is None) is not bool(graph.is_loop.any())
    assert "tune" in page["seconds"]


def test_the_tuned_run_says_phi_and_verdict(built, simulation, monkeypatch, mapmend, log_path, tmp_path):
    monkeypatch.setitem(slam.METHODS, slam.DEFAULT_METHOD, lambda *_: built)
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--robust", "auto")
    assert answer.code == 0
    assert "tuned: phi = " in answer.out
    page = json.loads((tmp_path / "run" / "run.json").read_text())
    assert page["tuning"]["consistent"] is True
    assert page["tuning"]["switched_off"] >= 2
