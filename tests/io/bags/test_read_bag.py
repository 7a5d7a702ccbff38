"""Bags written by rosbags hold the same log as the CARMEN file they were made from."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.geometry import se2
from mapmend.io.bags.messages import laser_message
from mapmend.io.bags.options import BagOptions
from mapmend.io.bags.read import read_bag
from mapmend.io.carmen import read_carmen
from mapmend.io.reader import read
from mapmend.slam import build_map
from tests.io.bags.writing import KINDS, BagWriter, Layout, nanoseconds, write_bag_of
from tests.real_data import data_path

ROUNDING = 1e-12  # of a yaw that went through a quaternion


def assert_same_log(read_log, log):
    assert np.array_equal(read_log.scans.ranges_m, log.scans.ranges_m, equal_nan=True)
    assert np.array_equal(read_log.scans.offsets, log.scans.offsets)
    assert np.array_equal(read_log.stamps_s, log.stamps_s)
    assert np.abs(se2.between(read_log.odometry, log.odometry)).max() < ROUNDING
    assert len(read_log.scans.geometries) == len(log.scans.geometries)
    for one, other in zip(read_log.scans.geometries, log.scans.geometries, strict=True):
        assert np.abs(one.bearings_rad() - other.bearings_rad()).max() < ROUNDING
        assert np.abs(np.array(one.T_robot_laser) - other.T_robot_laser).max() < ROUNDING
        assert one.max_range_m == other.max_range_m


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_holds_the_log_and_maps_to_the_same_trajectory(tmp_path, log, kind):
    from_bag = read(write_bag_of(tmp_path / "drive", kind, log))
    assert_same_log(from_bag, log)
    assert from_bag.has_odometry
    assert not from_bag.notes
    poses = build_map(from_bag).trajectory.poses
    assert np.abs(poses - build_map(log).trajectory.poses).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_intel_maps_to_the_same_trajectory_from_every_kind(tmp_path, kind):
    log = read_carmen(data_path("logs/intel.clf.bz2"))
    from_bag = read(write_bag_of(tmp_path / "intel", kind, log))
    assert_same_log(from_bag, log)
    poses = build_map(from_bag, threads=2).trajectory.poses
    assert np.abs(poses - build_map(log, threads=2).trajectory.poses).max() < 1e-6


@pytest.mark.parametrize(
    "layout",
    [
        Layout(upside_down=True),
        Layout(clockwise=True),
        Layout(upside_down=True, clockwise=True),
        Layout(odometry="tf"),
    ],
    ids=["upside down", "clockwise", "both", "odometry from tf"],
)
def test_however_the_laser_hangs_it_sees_the_same(tmp_path, log, layout):
    assert_same_log(read_bag(write_bag_of(tmp_path / "drive", "mcap", log, layout)), log)


def test_stamps_that_repeat_and_step_back_keep_each_scan_its_own_odometry(tmp_path, log):
    stamps = log.stamps_s.copy()
    stamps[10:14] = stamps[10]
    stamps[30] -= 5.0
    odd = replace(log, stamps_s=stamps)
    from_bag = read_bag(write_bag_of(tmp_path / "drive", "mcap", odd))
    assert_same_log(from_bag, odd)
    assert {note.what for note in from_bag.notes} == {"timestamp steps back", "timestamp repeats the one before"}


def test_odometry_is_interpolated_to_the_scans_time(tmp_path, log):
    """Poses on a straight line and an even turn through +-180 degrees, between which the truth is known."""
    first = nanoseconds(log.stamps_s[0])
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(6):
            pose = (k * 0.1, 0.0, np.pi - 0.2 + 0.1 * k)
            bag.write("/odom", bag.odometry(first + k * 50_000_000, pose), first + k * 50_000_000)
        for share in (0.0, 0.25, 2.5, 4.9):
            stamp = first + round(share * 50_000_000)
            bag.write("/scan", bag.scan(stamp, "base_link", np.ones(10), -1.0, 0.2, range_max=8.0), stamp)
    poses = read_bag(tmp_path / "a.mcap").odometry
    share = np.array([0.0, 0.25, 2.5, 4.9])
    assert poses[:, 0] == pytest.approx(0.1 * share, abs=1e-9)
    assert se2.wrap_angle(poses[:, 2] - (np.pi - 0.2 + 0.1 * share)) == pytest.approx(0.0, abs=1e-9)


def test_scans_outside_the_odometry_take_the_nearest_pose_and_are_counted(tmp_path):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(4):
            stamp = (10 + k) * 10**9
            bag.write("/scan", bag.scan(stamp, "base_link", np.ones(10), -1.0, 0.2, range_max=8.0), stamp)
            if k in (1, 2):
                bag.write("/odom", bag.odometry(stamp, (k, 0, 0)), stamp)
    log = read_bag(tmp_path / "a.mcap")
    assert log.odometry[:, 0].tolist() == [1, 1, 2, 2]
    assert "outside the odometry's time, by up to 1.0 s" in str(log.notes[0])
    assert log.notes[0].count == 2


def test_two_clocks_are_joined_by_the_times_of_recording(tmp_path):
    """A laser with stamps from its own start, and odometry with stamps of the date."""
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(5):
            now = 1_700_000_000 * 10**9 + k * 10**8
            bag.write("/odom", bag.odometry(now, (0.1 * k, 0, 0)), now)
            bag.write("/scan", bag.scan(k * 10**8, "base_link", np.ones(10), -1.0, 0.2, range_max=8.0), now)
    log = read_bag(tmp_path / "a.mcap")
    assert log.odometry[:, 0] == pytest.approx(0.1 * np.arange(5), abs=1e-6)
    assert log.stamps_s == pytest.approx(0.1 * np.arange(5))
    assert ["different clocks" in str(note) for note in log.notes] == [True]


def test_readings_mean_what_rep_117_says(tmp_path):
    readings = [1.0, np.nan, np.inf, -np.inf, 0.0, 0.05, 7.99, 8.0, 9.0, -1.0]
    expected = [1.0, np.nan, np.inf, np.nan, np.nan, np.nan, np.float32(7.99), np.inf, np.inf, np.nan]
    with BagWriter(tmp_path / "a.bag", "ros1") as bag:
        bag.write("/scan", bag.scan(10**9, "laser", readings, -1.0, 0.2, range_min=0.1, range_max=8.0), 10**9)
    scans = read_bag(tmp_path / "a.bag").scans
    assert np.array_equal(scans.ranges_m, np.array(expected, np.float32), equal_nan=True)
    assert scans.geometries[0].max_range_m == 8.0


def test_the_code_for_no_return_is_found_where_a_driver_never_says_inf(tmp_path):
    """A SICK's 81.83 behind a header that claims 100 m, as in logs that were converted from CARMEN."""
    random = np.random.default_rng(0)
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(20):
            readings = np.where(random.random(180) < 0.2, 81.83, random.uniform(1.0, 9.0, 180))
            bag.write("/scan", bag.scan(k * 10**8, "laser", readings, -1.5, 0.017, range_max=100.0), k * 10**8)
    log = read_bag(tmp_path / "a.mcap")
    assert not np.any(log.scans.ranges_m > 10.0, where=np.isfinite(log.scans.ranges_m))
    assert np.isinf(log.scans.ranges_m).mean() == pytest.approx(0.2, abs=0.05)
    assert any("81.83 m on taken as no return" in str(note) for note in log.notes)


def test_times_of_recording_stand_in_for_missing_stamps(tmp_path):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        for k in range(3):
            bag.write("/scan", bag.scan(0, "laser", np.ones(10), -1.0, 0.2, range_max=8.0), (5 + k) * 10**9)
    log = read_bag(tmp_path / "a.mcap")
    assert log.stamps_s.tolist() == [5.0, 6.0, 7.0]
    assert "the times of recording are used" in " ".join(map(str, log.notes))


def test_the_robots_frame_can_be_chosen(tmp_path, log):
    """Odometry of base_footprint, asked for a frame that is mounted 0.5 m ahead of it and turned."""
    offset = (0.5, 0.1, 0.3)
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        bag.write("/tf_static", bag.transform(0, "base_footprint", "arm", offset), 0)
        bag.write("/tf_static", bag.transform(0, "arm", "laser", (0.2, 0.0, -0.3)), 0)
        for k in range(5):
            bag.write("/tf", bag.transform(k * 10**8, "odom", "base_footprint", (0.1 * k, 0, 0.2 * k)), k * 10**8)
            bag.write("/scan", bag.scan(k * 10**8, "laser", np.ones(10), -1.0, 0.2, range_max=8.0), k * 10**8)
    default, arm = read_bag(tmp_path / "a.mcap"), read_bag(tmp_path / "a.mcap", BagOptions(base_frame="arm"))
    assert arm.odometry == pytest.approx(se2.compose(default.odometry, np.array(offset)), abs=1e-12)
    assert arm.scans.geometries[0].T_robot_laser == pytest.approx((0.2, 0.0, -0.3), abs=1e-12)
    T_footprint_laser = se2.compose(np.array(offset), np.array((0.2, 0.0, -0.3)))
    assert default.scans.geometries[0].T_robot_laser == pytest.approx(tuple(T_footprint_laser), abs=1e-12)


def test_messages_in_big_endian_are_read(tmp_path):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as bag:
        message = bag.scan(1_500_000_000, "laser", [1.0, 2.0], -1.0, 0.25, range_max=8.0)
        for little in (False, True):
            raw = bytes(bag.store.serialize_cdr(message, message.__msgtype__, little_endian=little))
            decoded = laser_message(raw, ros1=False)
            assert (decoded.stamp_ns, decoded.frame, decoded.angle_increment_rad) == (1_500_000_000, "laser", 0.25)
            assert decoded.ranges_m.tolist() == [1.0, 2.0]
        bag.write("/scan", message, 1)
