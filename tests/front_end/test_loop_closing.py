"""Which places are candidates for loops: by hand-made trajectories and covariances."""

import numpy as np
import pytest

from mapmend.config import Config, LoopConfig
from mapmend.front_end import loop_closing
from mapmend.front_end.loop_closing import Candidate, LoopSearch
from mapmend.matching.correlative import search
from mapmend.simulation import World, simulate
from mapmend.simulation._shapes import closed_line
from tests.front_end.logs import drive, empty_log, mapped
from tests.scan_graph.graphs import graph_of

CONFIG = Config()
CHI2_3_AT_99_PERCENT = 11.344867


def search_on(poses):
    """The loop search after a trajectory, its chain of nodes and its key-nodes."""
    graph = graph_of(empty_log(len(poses)), poses, np.eye(3) * 1e-6)
    return LoopSearch(graph), graph.chains, graph.key_nodes


def out_and_back(length_m, beside_m):
    """Every half metre along x and back, ``beside_m`` to the left."""
    x = np.arange(0.0, length_m, 0.5)
    out = [(a, 0.0, 0.0) for a in x]
    return out + [(a, beside_m, np.pi) for a in x[::-1]]


@pytest.mark.parametrize("wide", ["x", "y"])
def test_the_gate_opens_along_the_axis_in_which_the_pose_is_uncertain(wide):
    std = {"x": (4.0, 0.1), "y": (0.1, 4.0)}[wide]
    covariance = np.diag([std[0] ** 2, std[1] ** 2, 0.01])
    view = CONFIG.loops.view_std_m
    farthest = {axis: np.sqrt(CHI2_3_AT_99_PERCENT * (s**2 + view**2)) for axis, s in zip("xy", std, strict=True)}
    for axis, direction in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
        for share, passes in ((0.98, True), (1.02, False)):
            away = share * farthest[axis]
            search, _, _ = search_on([(0, 0, 0), (away * direction[0], away * direction[1], 0.0)])
            assert search._passes_gate(Candidate(0, 0), covariance) == passes


def test_the_gate_turns_with_the_robot():
    """The covariance is in the frame of the newest node: turned by 90 degrees, its long axis lies across the map's."""
    covariance = np.diag([100.0, 0.01, 0.01])
    for heading, passes in ((0.0, True), (np.pi / 2, False)):
        search, _, _ = search_on([(0, 0, 0), (20.0, 0.0, heading)])
        assert search._passes_gate(Candidate(0, 0), covariance) == passes


def test_whichever_way_two_poses_look_they_may_see_the_same_walls():
    for heading in np.linspace(-3.1, 3.1, 9):
        search, _, _ = search_on([(0, 0, 0), (1.0, 1.0, heading)])
        assert search._passes_gate(Candidate(0, 0), np.diag([0.01, 0.01, 0.001]))


def test_a_straight_trajectory_has_no_candidates():
    search, _, key_nodes = search_on([(0.5 * k, 0.0, 0.0) for k in range(400)])
    assert search._candidates(key_nodes.known()) == []


def test_what_was_just_left_is_no_candidate():
    search, chains, key_nodes = search_on(out_and_back(4.5, 0.2))
    assert chains.path_m[-1] < CONFIG.loops.min_separation_m
    assert search._candidates(key_nodes.known()) == []


def test_the_nearest_node_of_a_key_node_passed_before_is_a_candidate():
    search, chains, key_nodes = search_on(out_and_back(40.0, 1.0))
    candidates = search._candidates(key_nodes.known())
    assert candidates[0].key_node == 0
    assert candidates[0].nearest == 0
    away = [np.hypot(*(chains.poses[c.nearest] - chains.poses[-1])[:2]) for c in candidates]
    assert away == sorted(away)
    for candidate in candidates:
        row = key_nodes.rows[candidate.key_node]
        there = chains.poses[row.first : row.end] - chains.poses[-1]
        assert row.first <= candidate.nearest < row.end
        assert candidate.nearest == row.first + np.argmin(np.hypot(there[:, 0], there[:, 1]))


def test_candidates_reach_no_farther_than_drift_may_have_built_up():
    length = CONFIG.key_nodes.trajectory_length_m
    search, _, key_nodes = search_on(out_and_back(60.0, 3.5 * length))
    assert search._candidates(key_nodes.known()) == []


def test_the_relative_covariance_grows_with_the_way_between():
    search, chains, _ = search_on([(0.5 * k, 0.0, 0.0) for k in range(100)])
    sizes = [np.linalg.det(search._relative_covariance(Candidate(0, node))) for node in range(0, chains.last, 10)]
    assert sizes == sorted(sizes, reverse=True)
    assert np.all(np.linalg.eigvalsh(search._relative_covariance(Candidate(0, 0))) > 0.0)


def on_grids_that_hold_them(min_separation_m):
    """The loop edges of two rounds in a room, T_l of 10 m, whose node's own scan is in the grid it was matched on."""
    room = closed_line([(0.0, 0.0), (3.0, 0.0), (3.0, 0.4), (6.0, 0.4), (6.0, 5.5), (4.0, 5.5), (4.0, 6.0), (0.0, 6.0)])
    corners = [(1.5, 1.5), (4.5, 1.5), (4.5, 4.5), (1.5, 4.5)]
    drive = simulate(World(room, "room", np.array([*corners, *corners, corners[0]])), seed=1)
    config = Config().with_settings({"key_nodes.trajectory_length_m": 10.0, "loops.min_separation_m": 15.0})
    # Past the rule between the two settings, which refuses less than 15 m.
    object.__setattr__(config, "loops", LoopConfig(min_separation_m=min_separation_m))
    graph = mapped(drive.log, config).graph
    assert graph.loops
    grids = [(edge, graph.key_nodes.local_grid(int(graph.key_nodes.of_node[edge.anchor]))) for edge in graph.loops]
    return [edge for edge, grid in grids if grid.begin <= edge.node < grid.begin + len(grid.poses)]


def test_no_scan_is_matched_as_a_loop_on_a_grid_that_holds_it():
    """T_l and the least separation of 10 m each, which `Config` refuses: loop edges that agree with themselves."""
    assert on_grids_that_hold_them(min_separation_m=10.0)
    assert not on_grids_that_hold_them(min_separation_m=15.0)


def test_a_search_matches_the_newest_scan_and_not_one_that_a_grid_was_built_from(monkeypatch):
    graph, searched = mapped(drive(1).log).graph, []

    def spied(field, points, *others):
        searched.append(points.copy())
        return search(field, points, *others)

    monkeypatch.setattr(loop_closing, "search", spied)
    graph.key_nodes.forget_grids()
    LoopSearch(graph)._searched(Candidate(0, 0), np.diag([1.0, 1.0, 0.1]))
    np.testing.assert_array_equal(searched[0], graph.points.of(graph.chains.last))
