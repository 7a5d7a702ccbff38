"""A pose graph with scans, whatever system made it, is rebuilt: biased edges move, good ones and all names stay."""

from dataclasses import replace

import numpy as np
import pytest

import mapmend
from mapmend.config import Config
from mapmend.errors import MapmendError
from mapmend.evaluation.relations import relation_errors
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.geometry import se2
from mapmend.graph.optimizer import edge_chi2, optimize
from mapmend.io.reader import read
from mapmend.io.relations import read_relations
from mapmend.scan import Scans
from mapmend.scan_graph.scan_graph import ScanGraph
from tests.front_end.logs import drive, mapped
from tests.real_data import data_path

BIASED, OFF = 40, np.array([0.4, 0.0, 0.0])


@pytest.fixture(scope="module")
def building():
    """The graph of a simulated building, all edges with the same information, as some systems write; the true poses."""
    simulation = drive(3)
    scan_graph = mapped(simulation.log).graph
    graph = scan_graph.pose_graph(with_scans=True)
    information = np.tile(np.diag([100.0, 100.0, 500.0]), (len(graph.edges), 1, 1))
    graph = replace(graph, information=information, ids=np.arange(len(graph)) + 7)
    return graph.with_poses(optimize(graph).poses), simulation.truth[scan_graph.hung.node_scan]


def biased(graph):
    """The graph with one odometry edge 0.4 m too long, at its optimum."""
    measurements = graph.measurements.copy()
    measurements[BIASED] = se2.compose(measurements[BIASED], OFF)
    wrong = replace(graph, measurements=measurements)
    return wrong.with_poses(optimize(wrong).poses)


def errors_m(graph, truth):
    return trajectory_errors(graph.stamps_s, graph.poses, graph.stamps_s, truth).translation_rmse_m


def measured(graph, i, j):
    (row,) = np.flatnonzero((graph.ids[graph.edges] == (i, j)).all(axis=1))
    return graph.measurements[row], graph.information[row]


def test_a_biased_edge_moves_and_keeps_its_information(building):
    graph, truth = building
    result = mapmend.rebuild(biased(graph))
    i, j = graph.ids[graph.edges[BIASED]]
    motion, information = measured(result.graph, i, j)
    off = se2.between(graph.measurements[BIASED], motion)
    assert np.hypot(off[0], off[1]) < 0.04
    np.testing.assert_allclose(information, np.diag([100.0, 100.0, 500.0]))
    biased_m, rebuilt_m = errors_m(biased(graph), truth), errors_m(result.graph, truth)
    assert rebuilt_m < 0.9 * biased_m


def test_names_scans_stamps_and_good_edges_stay(building):
    graph, _ = building
    rebuilt = mapmend.rebuild(graph).graph
    np.testing.assert_array_equal(rebuilt.ids, graph.ids)
    np.testing.assert_array_equal(rebuilt.stamps_s, graph.stamps_s)
    np.testing.assert_array_equal(rebuilt.scans.ranges_m, graph.scans.ranges_m)
    assert rebuilt.fixed == graph.fixed
    np.testing.assert_array_equal(rebuilt.poses[0], graph.poses[0])
    before = {tuple(edge): graph.measurements[row].tobytes() for row, edge in enumerate(graph.edges.tolist())}
    same = [before[tuple(e)] == rebuilt.measurements[row].tobytes() for row, e in enumerate(rebuilt.edges.tolist())]
    assert np.mean(same) > 0.95


def test_the_order_of_nodes_and_the_direction_of_edges_change_nothing(building):
    """Nodes shuffled and every third edge turned round: the same map, under the same names."""
    graph, _ = building
    wrong = biased(graph)
    turn = np.arange(len(wrong.edges)) % 3 == 0
    carry = se2.adjoint(se2.inverse(wrong.measurements))
    information = np.where(turn[:, None, None], carry.swapaxes(1, 2) @ wrong.information @ carry, wrong.information)
    turned = replace(
        wrong,
        edges=np.where(turn[:, None], wrong.edges[:, ::-1], wrong.edges),
        measurements=np.where(turn[:, None], se2.inverse(wrong.measurements), wrong.measurements),
        information=0.5 * (information + information.swapaxes(1, 2)),
    )
    # The adjoint carries small errors exactly, the others to second order.
    np.testing.assert_allclose(edge_chi2(turned), edge_chi2(wrong), rtol=2e-3, atol=1e-9)
    order = np.random.default_rng(0).permutation(len(wrong))
    shuffled = turned.with_order(order)
    expected, found = mapmend.rebuild(wrong).graph, mapmend.rebuild(shuffled).graph
    np.testing.assert_array_equal(found.ids, shuffled.ids)
    np.testing.assert_allclose(se2.between(expected.poses[order], found.poses), 0.0, atol=1e-3)


def test_where_no_edge_joins_neighbours_the_chain_is_broken(building):
    graph, _ = building
    left = ~((graph.edges == (99, 100)).all(axis=1))
    broken = graph.with_edges(left)
    spans = (broken.edges[:, 0] < 100) & (broken.edges[:, 1] >= 100) & ~broken.is_loop
    scan_graph = ScanGraph.from_pose_graph(broken, Config())
    assert scan_graph.chains.starts == [0, 100]
    assert scan_graph.key_nodes.of_node[99] != scan_graph.key_nodes.of_node[100]
    # A further odometry edge over the break is none along the chain: it may be verified like a loop.
    assert len(scan_graph.loops) == broken.is_loop.sum() + spans.sum()
    result = mapmend.rebuild(broken)
    assert len(result.graph.edges) <= len(broken.edges)
    assert np.isfinite(result.graph.poses).all()


def test_a_node_without_a_scan_is_matched_by_none(building):
    graph, _ = building
    scans = graph.scans
    counts = np.diff(scans.offsets)
    keep = np.ones(len(graph), dtype=bool)
    keep[[50, 51, 120]] = False
    rows = np.repeat(keep, counts)
    offsets = np.concatenate(([0], np.cumsum(counts * keep)))
    bare = replace(graph, scans=Scans(scans.ranges_m[rows], offsets, scans.geometry_index, scans.geometries))
    result = mapmend.rebuild(bare)
    for j in (50, 51, 120):
        (row,) = np.flatnonzero((graph.edges == (j - 1, j)).all(axis=1))
        motion, _ = measured(result.graph, graph.ids[j - 1], graph.ids[j])
        np.testing.assert_array_equal(motion, graph.measurements[row])


def test_a_graph_without_scans_or_with_loose_nodes_is_refused(building):
    graph, _ = building
    with pytest.raises(MapmendError, match="carry no scans"):
        mapmend.rebuild(replace(graph, scans=None))
    with pytest.raises(MapmendError, match="no chain of edges joins node"):
        mapmend.rebuild(graph.with_edges((graph.edges < 100).all(axis=1)))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "limit_m"), [("intel", 0.0590), ("fr079", 0.0450)])
def test_graphs_of_another_system_are_no_worse_for_it(name, limit_m):
    graph = read(data_path(f"scangraphs/{name}.toro.gz"))
    true = read_relations(data_path(f"relations/{name}.relations"))
    rebuilt = mapmend.rebuild(graph).graph
    errors = relation_errors(rebuilt.stamps_s, rebuilt.poses, true.t1_s, true.t2_s, true.relative_poses)
    assert errors.translation_mean_m < limit_m
