"""The whole check, from a graph to a verdict."""

from dataclasses import replace

import numpy as np
import pytest

import mapmend
from mapmend.consistency.check import check
from mapmend.errors import MapmendError
from mapmend.io.reader import read
from mapmend.scan import LaserGeometry, Scans
from tests.consistency.scenes import graph_of, room_graph
from tests.real_data import data_path


def shifted(graph, metres, first):
    """The nodes from ``first`` on are displaced, as after a false loop; their odometry is unchanged."""
    poses = graph.poses.copy()
    poses[first:, 0] += metres
    return graph.with_poses(poses)


def test_a_room_seen_twice_is_consistent():
    result = mapmend.check(room_graph(80))
    assert result.consistent
    assert result.p_value > 0.05
    assert not result.notes


def test_a_double_wall_is_not():
    graph = shifted(room_graph(80), 0.4, 40)
    result = check(graph)
    assert not result.consistent
    assert result.scans.failed.mean() > 0.5
    assert result.regions[0].failures > 100
    x, y = result.regions[0].place_m
    assert -0.5 < x < 7.0
    assert -0.5 < y < 4.5
    assert result.points.any()


def test_the_same_for_any_number_of_threads():
    graph = shifted(room_graph(80), 0.4, 40)
    one, three = check(graph), check(graph, threads=3)
    assert one.p_value == three.p_value
    np.testing.assert_array_equal(one.pairs.psi, three.pairs.psi)
    np.testing.assert_array_equal(one.points, three.points)
    np.testing.assert_array_equal(one.suspects, three.suspects)


def without_scans(graph, rows):
    """The same graph, the given nodes without their scans."""
    counts = np.diff(graph.scans.offsets)
    counts[rows] = 0
    ranges = np.concatenate([graph.scans.ranges_of(k) for k in range(len(graph)) if k not in rows])
    offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    return replace(graph, scans=Scans(ranges, offsets, graph.scans.geometry_index, graph.scans.geometries))


def test_nodes_without_scans_are_left_out_and_said():
    graph = without_scans(room_graph(80), [3, 4, 5])
    result = check(graph)
    assert result.consistent
    assert "3 of 80 nodes carry no scan" in result.notes[0]
    assert result.scans.tested[[3, 4, 5]].tolist() == [0, 0, 0]


def test_a_graph_without_odometry_takes_the_sensors_scale_and_says_so():
    graph = room_graph(80)
    all_loops = replace(graph, is_loop=np.ones(len(graph.edges), np.bool_))
    result = check(all_loops)
    assert "no scale can be estimated" in result.notes[0]
    assert result.consistent
    assert not check(shifted(all_loops, 0.4, 40)).consistent


@pytest.mark.parametrize("scans", [0, 1])
def test_fewer_than_two_scans_are_refused(scans):
    graph = without_scans(room_graph(4), list(range(scans, 4))) if scans else replace(room_graph(4), scans=None)
    with pytest.raises(MapmendError, match=f"{scans} of 4 nodes carry a scan"):
        check(graph)


def test_scans_that_see_nothing_in_common_are_no_contradiction():
    graph = room_graph(6)
    apart = graph.with_poses(graph.poses + np.arange(6)[:, None] * np.array([100.0, 0.0, 0.0]))
    result = check(replace(apart, is_loop=np.ones(len(graph.edges), np.bool_)))
    assert result.consistent
    assert result.p_value == 1.0
    assert any("nothing was tested" in note for note in result.notes)


def test_scans_of_different_lasers_stand_in_one_graph():
    graph = room_graph(80)
    half = LaserGeometry(90, -np.pi / 2.0, np.pi / 90.0, 20.0)
    ranges, counts = [], []
    for k in range(80):
        readings = graph.scans.ranges_of(k)
        ranges.append(readings[::2] if k % 2 else readings)
        counts.append(len(ranges[-1]))
    offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    index = (np.arange(80) % 2).astype(np.int32)
    mixed = Scans(np.concatenate(ranges), offsets, index, (graph.scans.geometries[0], half))
    right = graph_of(graph.poses, mixed, [(0, 79)])
    assert check(right).consistent
    assert not check(shifted(right, 0.4, 40)).consistent


@pytest.mark.parametrize("name", ["intel.toro.gz", "fr079.toro.gz", "killian.g2o.gz"])
@pytest.mark.slow
def test_odometry_alone_fails_on_real_graphs(name):
    from mapmend.consistency.scale import odometry_map

    graph = read(data_path(f"scangraphs/{name}"))
    assert not check(graph.with_poses(odometry_map(graph).poses), threads=2).consistent


def test_a_map_of_raw_wheel_odometry_fails():
    """Its neighbouring scans contradict each other, by 0.24 m in the median: with such scales every map would pass."""
    log = mapmend.read_log(data_path("logs/fr079.clf.bz2"))
    assert not check(mapmend.build_map(log, "odometry").graph).consistent
