"""Odd bags: without odometry, with two lasers, without a frame, incomplete. They are refused, or mapped with notes."""

import contextlib
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmend.errors import InputError, MapmendError
from mapmend.io.bags import readings
from mapmend.io.bags.messages import BadMessageError, laser_message, odometry_message, transform_messages
from mapmend.io.bags.options import BagOptions
from mapmend.io.bags.read import read_bag
from mapmend.io.info import describe, describe_content
from mapmend.slam import build_map
from tests.io.bags.writing import KINDS, BagWriter, Layout, write_bag_of


def first_rows(log, count):
    rows = np.arange(count)
    return replace(
        log, scans=log.scans.select(rows), stamps_s=log.stamps_s[rows].copy(), odometry=log.odometry[rows].copy()
    )


def small_scan(bag, stamp_ns, frame="laser"):
    return bag.scan(stamp_ns, frame, np.linspace(1.0, 2.0, 10), -1.0, 0.2, range_max=8.0)


def test_without_odometry_the_laser_alone_is_used_and_it_says_so(tmp_path, log, mapmend):
    path = write_bag_of(tmp_path / "drive", "mcap", log, Layout(odometry=None))
    assert not read_bag(path).has_odometry
    answer = mapmend("map", path, "-o", tmp_path / "run")
    assert answer.code == 0
    assert "no odometry" in answer.err
    assert "the laser alone is used" in answer.err
    run = json.loads((tmp_path / "run/run.json").read_text())
    assert run["configuration"]["motion"]["use_odometry"] is False
    refused = mapmend("map", path, "-o", tmp_path / "other", "--method", "odometry")
    assert refused.code == 2
    assert "needs odometry" in refused.err


def test_without_scans_it_says_what_the_bag_holds(tmp_path, mapmend):
    with BagWriter(tmp_path / "a.bag", "ros1") as bag:
        bag.write("/odom", bag.odometry(1, (0, 0, 0)), 1)
    answer = mapmend("map", tmp_path / "a.bag", "-o", tmp_path / "run")
    assert answer.code == 2
    assert "holds no sensor_msgs/LaserScan; it holds /odom (nav_msgs/msg/Odometry)" in answer.complaint
    info = mapmend("info", tmp_path / "a.bag")
    assert info.code == 0
    assert "topic: /odom" in info.out


def test_of_two_lasers_one_has_to_be_chosen(tmp_path, log, mapmend):
    path = write_bag_of(tmp_path / "drive", "sqlite3", log, Layout(scan_topics=("/front", "/rear")))
    answer = mapmend("map", path, "-o", tmp_path / "run")
    assert answer.code == 2
    assert "2 topics hold LaserScans: /front (120), /rear (120); choose one with --scan-topic" in answer.complaint
    wrong = mapmend("map", path, "-o", tmp_path / "run", "--scan-topic", "/left")
    assert "no LaserScans on '/left'; there are /front (120), /rear (120)" in wrong.complaint
    assert len(read_bag(path, BagOptions(scan_topic="rear"))) == 120
    info = mapmend("info", path, "--json")
    page = json.loads(info.out)
    assert [t["name"] for t in page["topics"]] == ["/front", "/odom", "/rear", "/tf_static"]
    assert "--scan-topic" in " ".join(page["notes"])


def test_of_two_odometries_one_has_to_be_chosen(tmp_path):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(3):
            bag.write("/wheels", bag.odometry(k * 10**8, (0.1 * k, 0, 0)), k * 10**8)
            bag.write("/fused", bag.odometry(k * 10**8, (0.2 * k, 0, 0)), k * 10**8)
            bag.write("/tf", bag.transform(k * 10**8, "odom", "base_link", (0.3 * k, 0, 0)), k * 10**8)
            bag.write("/scan", small_scan(bag, k * 10**8, "base_link"), k * 10**8)
    with pytest.raises(InputError, match=r"/fused \(3\), /wheels \(3\); choose one with --odom-topic"):
        read_bag(tmp_path / "a.mcap")
    for topic, step in (("/wheels", 0.1), ("fused", 0.2), ("/tf", 0.3)):
        log = read_bag(tmp_path / "a.mcap", BagOptions(odom_topic=topic))
        assert log.odometry[:, 0] == pytest.approx([0.0, step, 2 * step])


def test_a_laser_without_a_transform_is_put_at_the_centre_with_a_note(tmp_path, log):
    from_bag = read_bag(write_bag_of(tmp_path / "drive", "mcap", log, Layout(static=False)))
    assert from_bag.scans.geometries[0].T_robot_laser == (0.0, 0.0, 0.0)
    assert "no transform leads from frame 'base_link' to 'laser'" in str(from_bag.notes[0])


def test_a_frame_that_is_not_there_is_refused_with_those_that_are(tmp_path, log, mapmend):
    path = write_bag_of(tmp_path / "drive", "mcap", log)
    answer = mapmend("map", path, "-o", tmp_path / "run", "--base-frame", "base")
    assert answer.code == 2
    assert "there is no frame 'base'; it knows base_link, laser" in answer.complaint


def test_the_odometrys_frame_may_be_unknown_to_the_transforms(tmp_path):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        bag.write("/tf_static", bag.transform(0, "base_link", "laser", (0.2, 0, np.pi)), 0)
        bag.write("/tf", bag.transform(0, "base_link", "arm", (np.nan, 0, 0)), 0)
        for k in range(3):
            bag.write("/odom", bag.odometry(k * 10**8, (0.1 * k, 0, 0), child="base_footprint"), k * 10**8)
            bag.write("/scan", small_scan(bag, k * 10**8), k * 10**8)
    for options in (BagOptions(), BagOptions(base_frame="base_link")):
        log = read_bag(tmp_path / "a.mcap", options)
        assert log.scans.geometries[0].T_robot_laser == pytest.approx((0.2, 0, np.pi))
        assert [str(note) for note in log.notes] == [
            "transform that is not finite, left out",
            "no transform has the odometry's frame 'base_footprint'; it is taken for 'base_link'",
        ]


def test_a_laser_that_looks_at_the_floor_or_turns_is_refused(tmp_path):
    for name, roll, turn, what in (
        ("tilted", 1.0, 0.0, "tilted by 57 degrees .*; choose another laser with --scan-topic$"),
        ("turning", 0.0, 0.1, "moves relative to .*; choose the robot's frame with --base-frame$"),
    ):
        with BagWriter(tmp_path / name, "mcap") as bag:
            for k in range(3):
                bag.write("/odom", bag.odometry(k * 10**8, (0.1 * k, 0, 0)), k * 10**8)
                bag.write("/tf", bag.transform(k * 10**8, "base_link", "laser", (0, 0, turn * k), roll), k * 10**8)
                bag.write("/scan", small_scan(bag, k * 10**8), k * 10**8)
        with pytest.raises(InputError, match=what):
            read_bag(tmp_path / name)


def test_info_tells_rates_gaps_and_frames(tmp_path, mapmend):
    with BagWriter(tmp_path / "a.bag", "ros1") as bag:
        bag.write("/tf_static", bag.transform(0, "base_link", "laser", (0.1, 0, 0), np.pi), 0)
        for k in (0, 1, 2, 3, 9, 10):
            bag.write("/tf", bag.transform(k * 10**8, "odom", "base_link", (0.1 * k, 0, 0)), k * 10**8)
            bag.write("/scan", small_scan(bag, k * 10**8), k * 10**8)
    page = json.loads(mapmend("info", tmp_path / "a.bag", "--json").out)
    assert page["kind"] == "bag"
    scan = next(topic for topic in page["topics"] if topic["name"] == "/scan")
    assert (scan["messages"], scan["rate_hz"], scan["longest_gap_s"]) == (6, 5.0, 0.6)
    assert [(f["parent"], f["child"], f["moves"]) for f in page["frames"]] == [
        ("base_link", "laser", False),
        ("odom", "base_link", True),
    ]
    assert page["scans"] == 6
    text = "\n".join(describe(tmp_path / "a.bag").lines())
    assert "topic: /scan (sensor_msgs/msg/LaserScan), 6 messages, 5.0 Hz, longest gap 0.60 s" in text
    assert "frame: base_link -> laser, at x 0.1 m, y 0 m, z 0 m, 0 deg, upside down" in text
    assert "frame: odom -> base_link, moves" in text


def test_without_rosbags_it_says_what_to_install(tmp_path, log, monkeypatch):
    path = write_bag_of(tmp_path / "drive", "mcap", log)
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(MapmendError, match=r"rosbags is not installed; pip install 'mapmend\[ros\]'"):
        read_bag(path)


def test_options_of_bags_are_refused_for_other_files(tmp_path, log_path, mapmend):
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--deskew")
    assert answer.code == 2
    assert "is no ROS bag" in answer.complaint


def cut(path, share):
    """Leaves the first part of a bag's file."""
    file = next(f for f in path.iterdir() if f.suffix != ".yaml") if path.is_dir() else path
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.5, 0.99])
def test_a_bag_cut_off_is_read_up_to_there(tmp_path, log, kind, share):
    path = write_bag_of(tmp_path / "drive", kind, log)
    cut(path, share)
    salvaged = read_bag(path)
    assert 0.8 * share * len(log) < len(salvaged) <= len(log)
    assert "damaged" in str(salvaged.notes[0])
    rows = np.searchsorted(log.stamps_s, salvaged.stamps_s)  # a database may lose some of the last page
    assert np.array_equal(rows[:40], np.arange(40))
    assert np.array_equal(salvaged.stamps_s, log.stamps_s[rows])
    assert np.array_equal(salvaged.scans.ranges_m, log.scans.select(rows).ranges_m, equal_nan=True)
    assert salvaged.odometry == pytest.approx(log.odometry[rows], abs=1e-12)


def test_a_bag_cut_off_is_mapped_with_a_warning(tmp_path, log, mapmend):
    path = write_bag_of(tmp_path / "drive", "mcap", log)
    cut(path, 0.6)
    answer = mapmend("map", path, "-o", tmp_path / "run")
    assert answer.code == 0
    assert "note: the bag is cut off or damaged" in answer.err
    assert "cut off or damaged" in mapmend("info", path).out


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_which_nothing_is_left_is_one_line(tmp_path, log, kind, mapmend):
    path = write_bag_of(tmp_path / "drive", kind, log)
    cut(path, 0.002)
    answer = mapmend("map", path, "-o", tmp_path / "run")
    assert answer.code == 2
    assert str(path) in answer.complaint


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_bytes_are_damaged_it_is_read_or_refused_in_a_line(tmp_path, log, kind):
    path = write_bag_of(tmp_path / "drive", kind, first_rows(log, 20))
    file = next(f for f in path.iterdir() if f.suffix != ".yaml") if path.is_dir() else path
    whole, random = file.read_bytes(), np.random.default_rng(1)
    for _ in range(25):
        data = np.frombuffer(whole, np.uint8).copy()
        # Headers and the index at the end are where a wrong byte does most.
        places = np.concatenate((random.integers(0, len(data), 5), random.integers(0, 3000, 3)))
        places = np.concatenate((places, len(data) - 1 - random.integers(0, 2000, 3)))
        places = places[random.random(len(places)) < random.random()]
        data[places] = random.integers(0, 256, len(places))
        file.write_bytes(data.tobytes()[: random.integers(1, len(data)) if random.random() < 0.2 else len(data)])
        try:
            describe(path)
            read_bag(path, lenient=True)
        except MapmendError as error:
            assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_folder_whose_recorder_did_not_end_is_read(tmp_path, log, kind):
    path = write_bag_of(tmp_path / "drive", kind, log)
    (path / "metadata.yaml").unlink()
    assert len(read_bag(path)) == len(log)


@pytest.mark.parametrize("packing", ["bz2", "lz4", "zstd"])
def test_packed_bags_are_read_whole_and_cut(tmp_path, log, packing):
    path, noise = tmp_path / "drive", np.random.default_rng(0).random(8_000)
    with BagWriter(path, "mcap" if packing == "zstd" else "ros1", packing=packing) as bag:
        for k in range(len(log)):
            scan = bag.scan(k * 10**8, "laser", log.scans.ranges_of(k), -1.5, 0.01, range_max=8.0)
            bag.write("/scan", scan, k * 10**8)
            bag.write("/noise", bag.scan(0, "x", noise + k, 0, 0.1, range_max=8.0), 0)
    chosen = BagOptions(scan_topic="/scan")
    assert np.array_equal(read_bag(path, chosen).scans.ranges_m, log.scans.ranges_m, equal_nan=True)
    cut(path, 0.7)
    assert 0.4 * len(log) < len(read_bag(path, chosen)) < 0.8 * len(log)


def test_a_message_of_another_kind_than_it_says_is_refused_or_left_out(tmp_path):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(4):
            bag.write("/scan", small_scan(bag, k * 10**8), k * 10**8)
        bag.writer.write(bag.connections["/scan"], 10**9, b"\0\1\0\0short")
    with pytest.raises(InputError, match="a message on /scan can't be read: a LaserScan is cut short"):
        read_bag(tmp_path / "a.mcap")
    lenient = read_bag(tmp_path / "a.mcap", lenient=True)
    assert len(lenient) == 4
    assert "message left out" in str(lenient.notes[0])


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_said_not_to_be(raw):
    for ros1 in (False, True):
        for decode in (laser_message, odometry_message, transform_messages):
            with contextlib.suppress(BadMessageError):
                decode(raw, ros1)


@pytest.mark.parametrize("layout", [Layout(), Layout(upside_down=True)], ids=["upright", "upside down"])
def test_readings_on_disk_are_those_in_memory(tmp_path, log, monkeypatch, layout):
    path = write_bag_of(tmp_path / "drive", "mcap", log, layout)
    in_memory = read_bag(path)
    monkeypatch.setattr(readings, "MOST_IN_MEMORY", 1000)
    on_disk = read_bag(path)
    assert isinstance(on_disk.scans, readings.StoredScans)
    assert np.array_equal(on_disk.scans.ranges_m, in_memory.scans.ranges_m, equal_nan=True)
    for k in (0, 50, 119):
        assert np.array_equal(on_disk.scans.ranges_of(k), in_memory.scans.ranges_of(k), equal_nan=True)
    few = np.array([3, 1, 100])
    assert np.array_equal(on_disk.scans.select(few).ranges_m, in_memory.scans.select(few).ranges_m, equal_nan=True)
    assert describe_content(on_disk).facts == describe_content(in_memory).facts
    one, other = build_map(on_disk), build_map(in_memory)
    assert np.array_equal(one.trajectory.poses, other.trajectory.poses)
    assert np.array_equal(one.occupancy.image, other.occupancy.image)
