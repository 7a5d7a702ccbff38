"""Key-nodes: when they open, how far apart they are along links, and which local grids are kept."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.matching.gauss_newton import SurfaceMatcher
from mapmend.scan_graph.key_nodes import KEPT_GRIDS
from mapmend.scan_graph.scan_graph import ScanGraph
from tests.front_end.logs import drive, empty_log
from tests.scan_graph.graphs import add_node

CONFIG = Config()


def along_a_line(steps_m, config=CONFIG):
    """A graph whose nodes lie the given steps apart, its key-nodes, and which of the nodes opened one."""
    log = empty_log(len(steps_m) + 1)
    graph = ScanGraph(config, log.scans.geometries)
    opened, x = [], 0.0
    for k, step in enumerate([0.0, *steps_m]):
        x += step
        if add_node(graph, log, k, np.array([x, 0.0, 0.0]), np.eye(3), np.eye(3)):
            opened.append(k)
    return graph, graph.key_nodes, opened


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.01, 3.0), max_size=60))
def test_a_key_node_opens_when_the_trajectory_since_the_last_is_long_enough(steps_m):
    graph, key_nodes, opened = along_a_line(steps_m)
    length = CONFIG.key_nodes.trajectory_length_m
    expected, since = [0], 0.0
    for k, step in enumerate(steps_m, 1):
        since += step
        if graph.chains.path_m[k] - graph.chains.path_m[expected[-1]] > length:
            expected.append(k)
    assert opened == expected
    assert [row.first for row in key_nodes.rows] == expected
    assert [row.end for row in key_nodes.rows] == [*expected[1:], len(steps_m) + 1]
    for k, row in enumerate(key_nodes.rows):
        assert set(key_nodes.of_node[row.first : row.end]) == {k}


def test_turning_on_the_spot_opens_no_key_node():
    _, key_nodes, opened = along_a_line([0.0] * 200)
    assert opened == [0]
    assert key_nodes.last == 0


@settings(max_examples=60, deadline=None)
@given(
    st.integers(2, 25).flatmap(
        lambda n: st.tuples(
            st.just(n),
            st.lists(
                st.tuples(st.integers(0, n - 1), st.integers(0, n - 1), st.floats(0.1, 9.0)).filter(
                    lambda link: link[0] != link[1]
                ),
                max_size=30,
            ),
        )
    ),
    st.floats(0.0, 60.0),
)
def test_distances_along_links_are_those_of_dijkstra(drawn, limit_m):
    n, links = drawn
    _, key_nodes, opened = along_a_line([6.0] * (n - 1))
    assert len(opened) == n
    lengths = np.full((n, n), np.inf)
    for k in range(n - 1):
        lengths[k, k + 1] = CONFIG.key_nodes.trajectory_length_m
    for a, b, length_m in links:
        key_nodes.link(a, b, length_m)
        pair = (min(a, b), max(a, b))
        lengths[pair] = min(lengths[pair], length_m)
    lengths[np.isinf(lengths)] = 0.0
    expected = dijkstra(csr_array(lengths), directed=False, limit=limit_m + 1e-9)
    for start in {0, n // 2, n - 1}:
        found = key_nodes.distances(start, limit_m + 1e-9)
        assert found.keys() == set(np.flatnonzero(np.isfinite(expected[start])).tolist())
        for k, distance in found.items():
            assert distance == pytest.approx(expected[start, k])


def test_a_verified_loop_is_no_way_at_all():
    _, key_nodes, _ = along_a_line([6.0] * 40)
    key_nodes.link(0, 40, 0.0)
    found = key_nodes.distances(40, 11.0)
    assert found == {40: 0.0, 0: 0.0, 39: 5.0, 1: 5.0, 38: 10.0, 2: 10.0}


def test_a_new_link_is_known_at_once():
    _, key_nodes, _ = along_a_line([6.0] * 40)
    assert 0 not in key_nodes.known()
    key_nodes.link(0, key_nodes.last, 0.0)
    assert key_nodes.known()[0] == 0.0
    key_nodes.link(0, key_nodes.last, 3.0)  # a longer way changes nothing
    assert key_nodes.known()[0] == 0.0


def test_a_new_key_node_knows_its_own_neighbours():
    graph, key_nodes, _ = along_a_line([6.0] * 3)
    assert key_nodes.known()[3] == 0.0
    longer, more, _ = along_a_line([6.0] * 4)
    assert more.known() == {k: 5.0 * (4 - k) for k in range(5)}
    assert len(longer) == len(graph) + 1


@pytest.fixture(scope="module")
def driven():
    """The true poses of a simulated drive as nodes, every second scan."""
    return driven_through(replace(CONFIG, key_nodes=replace(CONFIG.key_nodes, trajectory_length_m=2.0)))


def driven_through(config, scans=range(0, 10**6, 2)):
    """A graph of the true poses of a simulated drive at the given scans, and its key-nodes."""
    simulation = drive(1)
    log = simulation.log
    graph = ScanGraph(config, log.scans.geometries)
    for scan in scans[: len(log) // 2]:
        add_node(graph, log, scan, simulation.truth[scan], np.eye(3), np.eye(3))
    return graph, graph.key_nodes


def test_only_the_local_grids_asked_for_last_are_kept(driven):
    _, key_nodes = driven
    assert key_nodes.last > KEPT_GRIDS
    first = key_nodes.local_grid(0)
    assert key_nodes.local_grid(0) is first
    for k in range(1, KEPT_GRIDS):
        key_nodes.local_grid(k)
    assert key_nodes.local_grid(0) is first  # asked for again: it stays, and the oldest goes
    for k in range(KEPT_GRIDS, KEPT_GRIDS + 3):
        key_nodes.local_grid(k)
    assert len(key_nodes._grids) == KEPT_GRIDS


def test_a_local_grid_is_built_anew_when_its_key_node_has_grown():
    simulation = drive(1)
    graph, key_nodes = driven_through(CONFIG, range(0, 20, 2))
    half = key_nodes.local_grid(0)
    for scan in range(20, 30, 2):
        add_node(graph, simulation.log, scan, simulation.truth[scan], np.eye(3), np.eye(3))
    assert key_nodes.last == 0
    assert len(half.poses) == 10
    assert len(key_nodes.local_grid(0).poses) == 15


def test_a_local_grid_stands_in_the_frame_of_its_key_nodes_first_node(driven):
    """What a node of the key-node saw lies in its grid where the node stood relative to the first."""
    graph, key_nodes = driven
    row = key_nodes.rows[5]
    local = key_nodes.local_grid(5)
    node = (row.first + row.end) // 2
    pose = se2.between(graph.chains.poses[row.first], graph.chains.poses[node])
    points = graph.points.of(node)
    matched, _, _ = SurfaceMatcher(CONFIG.match).judge(local.grid, points, pose)
    assert matched > 0.95 * len(points)


def test_a_likelihood_field_is_made_once(driven):
    _, key_nodes = driven
    assert key_nodes.likelihood(3) is key_nodes.likelihood(3)
