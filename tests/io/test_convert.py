"""Lossless conversions can be undone; losses are reported; conversions that make no sense are refused."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.errors import InputError, MapmendError, OutputError
from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.carmen import write_carmen
from mapmend.io.convert import convert
from mapmend.io.g2o import write_g2o
from mapmend.io.kitti import read_kitti
from mapmend.io.reader import read
from mapmend.io.tum import write_tum
from mapmend.scan import LaserGeometry, Scans
from mapmend.simulation import corridor_loop, first_scans, simulate
from tests.real_data import data_path

ROUNDING = 1e-12  # of a yaw that went through a quaternion


@pytest.fixture(scope="module")
def log():
    return first_scans(simulate(corridor_loop(), seed=5), 50).log


@pytest.fixture
def log_file(tmp_path, log):
    write_carmen(tmp_path / "log.clf", log)
    return tmp_path / "log.clf"


@pytest.fixture
def graph(log):
    """Ten nodes with scans and stamps, one of them fixed in the middle, and a loop."""
    rows = np.arange(0, 50, 5)
    poses = log.odometry[rows]
    edges = np.array([*((i, i + 1) for i in range(9)), (9, 0)])
    measurements = se2.between(poses[edges[:, 0]], poses[edges[:, 1]])
    information = np.tile(np.diag((100.0, 200.0, 300.0)), (10, 1, 1))
    is_loop = np.arange(10) == 9
    return PoseGraph(
        poses, rows, edges, measurements, information, is_loop, log.scans.select(rows), log.stamps_s[rows], (4,)
    )


def assert_same_log(one, other, rounding=ROUNDING):
    assert np.array_equal(one.scans.ranges_m, other.scans.ranges_m, equal_nan=True)
    assert np.array_equal(one.stamps_s, other.stamps_s)
    assert np.abs(se2.between(one.odometry, other.odometry)).max() < rounding
    for a, b in zip(one.scans.geometries, other.scans.geometries, strict=True):
        assert np.abs(a.bearings_rad() - b.bearings_rad()).max() < rounding
        assert a.max_range_m == b.max_range_m
        assert a.T_robot_laser == pytest.approx(b.T_robot_laser, abs=rounding)


@pytest.mark.parametrize(("name", "form"), [("bag", None), ("bag", "sqlite3"), ("bag.mcap", None)])
def test_a_log_comes_back_from_every_bag(tmp_path, log_file, log, name, form):
    done = convert(log_file, tmp_path / name, form)
    assert (done.kind, done.count, done.lost) == ("log", 50, ())
    assert_same_log(read(tmp_path / name), log)
    back = convert(tmp_path / name, tmp_path / "back.clf")
    assert_same_log(read(tmp_path / "back.clf"), log)
    assert any("other topics" in loss for loss in back.lost)
    assert not list(tmp_path.glob(".*"))


def test_two_lasers_keep_their_mountings_in_a_bag(tmp_path, log):
    ahead = replace(log.scans.geometries[0], T_robot_laser=(0.3, 0.0, 0.0))
    behind = LaserGeometry(ahead.beam_count, ahead.first_angle_rad, ahead.angle_increment_rad, 8.0, (-0.3, 0.1, np.pi))
    index = (np.arange(50) % 2).astype(np.int32)
    both = replace(log, scans=Scans(log.scans.ranges_m, log.scans.offsets, index, (ahead, behind)))
    write_carmen(tmp_path / "log.clf", both)
    convert(tmp_path / "log.clf", tmp_path / "bag.mcap")
    assert_same_log(read(tmp_path / "bag.mcap"), both)


@pytest.mark.parametrize("name", ["graph.toro", "graph.g2o"])
def test_a_graph_keeps_all_it_has(tmp_path, graph, name):
    write_g2o(tmp_path / "in.g2o", graph)
    assert convert(tmp_path / "in.g2o", tmp_path / name).lost == ()
    copy = read(tmp_path / name)
    for field in ("poses", "ids", "edges", "measurements", "information", "is_loop", "stamps_s"):
        assert np.array_equal(getattr(copy, field), getattr(graph, field)), field
    assert copy.fixed == (4,)
    assert np.array_equal(copy.scans.ranges_m, graph.scans.ranges_m, equal_nan=True)


def test_a_graph_with_scans_becomes_a_log_with_its_poses_as_odometry(tmp_path, graph):
    write_g2o(tmp_path / "in.g2o", graph)
    done = convert(tmp_path / "in.g2o", tmp_path / "log.mcap")
    assert done.count == 10
    assert done.lost == ("10 edges; the nodes' poses are written as odometry",)
    log = read(tmp_path / "log.mcap")
    assert np.abs(se2.between(log.odometry, graph.poses)).max() < ROUNDING
    assert np.array_equal(log.stamps_s, graph.stamps_s)


def test_trajectories_of_everything(tmp_path, log_file, log, graph):
    write_g2o(tmp_path / "in.g2o", graph)
    assert "raw odometry" in convert(log_file, tmp_path / "log.tum").lost[0]
    assert convert(tmp_path / "in.g2o", tmp_path / "graph.tum").lost == ("10 edges and the scans",)
    assert convert(tmp_path / "graph.tum", tmp_path / "graph.kitti").lost == ("the stamps",)
    assert read(tmp_path / "log.tum").poses == pytest.approx(log.odometry, abs=ROUNDING)
    assert read_kitti(tmp_path / "graph.kitti") == pytest.approx(graph.poses, abs=ROUNDING)
    (tmp_path / "times.txt").write_text("".join(f"{t!r}\n" for t in graph.stamps_s.tolist()))
    convert(tmp_path / "graph.kitti", tmp_path / "again.tum", stamps=tmp_path / "times.txt")
    again = read(tmp_path / "again.tum")
    assert np.array_equal(again.stamps_s, graph.stamps_s)
    assert again.poses == pytest.approx(graph.poses, abs=ROUNDING)


def test_what_makes_no_sense_is_refused_with_the_reason(tmp_path, log_file, log, graph):
    bare = replace(graph, scans=None, stamps_s=None)
    write_g2o(tmp_path / "bare.g2o", bare)
    write_tum(tmp_path / "path.tum", log.stamps_s, log.odometry)
    convert(tmp_path / "path.tum", tmp_path / "path.kitti")
    cases = [
        (log_file, "x.g2o", "it has no edges.*mapmend map"),
        (tmp_path / "path.tum", "x.g2o", "it has no edges"),
        (tmp_path / "path.tum", "x.clf", "no scans"),
        (tmp_path / "path.kitti", "x.mcap", "no scans"),
        (tmp_path / "bare.g2o", "x.clf", "carry no scans"),
        (tmp_path / "bare.g2o", "x.tum", "no stamps, and TUM needs them; give their times with --stamps"),
        (tmp_path / "path.kitti", "x.tum", "no stamps, and TUM needs them"),
    ]
    for source, name, reason in cases:
        with pytest.raises(InputError, match=reason):
            convert(source, tmp_path / name)
        assert not (tmp_path / name).exists()
    for name, reason in (("x.bag", "ROS 1 bags are read, not written"), ("x.xyz", "the name has no known suffix")):
        with pytest.raises(MapmendError, match=reason):
            convert(log_file, tmp_path / name)


def test_a_folder_that_holds_something_is_not_replaced(tmp_path, log_file):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("dear")
    with pytest.raises(OutputError, match="is there already"):
        convert(log_file, tmp_path / "mine")
    assert (tmp_path / "mine/letter.txt").read_text() == "dear"


def test_a_cameras_poses_are_refused(tmp_path):
    """KITTI's own files: z looks ahead, so the turn is about y."""
    (tmp_path / "00.txt").write_text("0 0 1 5 0 1 0 0 -1 0 0 7\n")
    with pytest.raises(InputError, match="tilted against the plane"):
        convert(tmp_path / "00.txt", tmp_path / "x.kitti")


def test_the_command_tells_what_came_of_it(tmp_path, log_file, mapmend):
    answer = mapmend("convert", log_file, tmp_path / "path.tum")
    assert answer.code == 0
    assert "path.tum: tum, 50 of the log's scans\n  lost: the scans; the poses are the raw odometry" in answer.out
    assert mapmend("convert", log_file, tmp_path / "x.g2o").code == 2


def test_a_published_graph_goes_to_toro_and_back(tmp_path):
    source = data_path("scangraphs/intel.toro.gz")
    convert(source, tmp_path / "intel.g2o")
    convert(tmp_path / "intel.g2o", tmp_path / "back.toro")
    one, other = read(source), read(tmp_path / "back.toro")
    assert np.array_equal(one.poses, other.poses)
    assert np.array_equal(one.information, other.information)
    assert np.array_equal(one.scans.ranges_m, other.scans.ranges_m, equal_nan=True)
