"""A sweep of a moving robot, straightened, is the scan that a robot standing where the sweep began would have seen."""

import numpy as np
import pytest

from mapmend.geometry import se2
from mapmend.io.bags.options import BagOptions
from mapmend.io.bags.read import read_bag
from tests.io.bags.writing import BagWriter

BEAMS, SWEEP_S = 360, 0.1
STEP = np.deg2rad(0.5)
FIRST = -STEP * (BEAMS - 1) / 2
ROOM = ((-4.0, 5.0), (-3.0, 2.5))  # x and y of its walls
MOUNTING = np.array((0.3, 0.05, 0.2))
VELOCITY = np.array((1.0, 0.0, 1.5))  # m/s and rad/s in the robot's frame: fast


def distance_in_room(laser, bearing):
    """From a pose of the laser to the wall in a direction."""
    x, y, yaw = laser
    c, s = np.cos(yaw + bearing), np.sin(yaw + bearing)
    (left, right), (low, high) = ROOM
    return min((right - x) / c if c > 0 else (left - x) / c, (high - y) / s if s > 0 else (low - y) / s)


def robot_at(time_s):
    """Along an arc, driven evenly."""
    angle = VELOCITY[2] * time_s
    radius = VELOCITY[0] / VELOCITY[2]
    return np.array((radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle))


def sweep(start_s, step, duration_s=SWEEP_S):
    """The readings of a sweep that begins at a time, beam after beam."""
    first = FIRST if step > 0 else -FIRST
    times = start_s + np.linspace(0.0, duration_s, BEAMS)
    lasers = [se2.compose(robot_at(t), MOUNTING) for t in times]
    return np.array([distance_in_room(p, first + k * step) for k, p in enumerate(lasers)]), first


@pytest.fixture(params=[STEP, -STEP], ids=["counter-clockwise", "clockwise"])
def bag(request, tmp_path):
    step = request.param
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as writer:
        writer.write("/tf_static", writer.transform(0, "base_link", "laser", MOUNTING), 0)
        for k in range(30):
            writer.write("/odom", writer.odometry(k * 20_000_000, robot_at(0.02 * k)), k * 20_000_000)
        for k in range(4):
            ranges, first = sweep(0.1 * k, step)
            increment = SWEEP_S / (BEAMS - 1)
            scan = writer.scan(k * 10**8, "laser", ranges, first, step, range_max=30.0, time_increment=increment)
            writer.write("/scan", scan, 600_000_000 + k)
    return tmp_path / "a.mcap"


def test_straightened_sweeps_are_what_a_standing_robot_sees(bag):
    raw, straight = read_bag(bag), read_bag(bag, BagOptions(deskew=True))
    for k in range(4):
        truth, _ = sweep(0.1 * k, STEP, duration_s=0.0)
        seen = np.isfinite(straight.scans.ranges_of(k))
        errors = np.abs(straight.scans.ranges_of(k) - truth)[seen]
        # Across a corner of the room the segment between two readings cuts it off, by half a beam's width at most.
        assert np.median(errors) < 0.001
        assert errors.max() < 0.04
        assert np.median(np.abs(raw.scans.ranges_of(k) - truth)) > 0.05
        # The robot turns by 8.6 degrees within a sweep: as many at one end were never looked at.
        assert np.count_nonzero(~seen) < 0.06 * BEAMS
    assert "sweep de-skewed (4 times)" in map(str, straight.notes)


def test_what_came_back_from_nowhere_stays_so(tmp_path):
    readings = np.full(BEAMS, np.inf)
    readings[100:150] = 2.0
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as writer:
        for k in range(2):
            writer.write("/odom", writer.odometry(k * 10**8, (0.05 * k, 0, 0.05 * k)), k * 10**8)
        scan = writer.scan(0, "base_link", readings, FIRST, STEP, range_max=30.0, time_increment=SWEEP_S / BEAMS)
        writer.write("/scan", scan, 10**8)
    ranges = read_bag(tmp_path / "a.mcap", BagOptions(deskew=True)).scans.ranges_m
    assert abs(np.count_nonzero(np.isfinite(ranges)) - 50) <= 3
    assert np.isposinf(ranges[:90]).mean() > 0.9


@pytest.mark.parametrize("has_odometry", [False, True])
def test_why_nothing_was_straightened_is_said(tmp_path, has_odometry):
    with BagWriter(tmp_path / "a.mcap", "bare mcap") as writer:
        for k in range(2):
            if has_odometry:
                writer.write("/odom", writer.odometry(k * 10**8, (0.05 * k, 0, 0)), k * 10**8)
            scan = writer.scan(k * 10**8, "base_link", np.ones(BEAMS), FIRST, STEP, range_max=30.0)
            writer.write("/scan", scan, k * 10**8)
    notes = " ".join(map(str, read_bag(tmp_path / "a.mcap", BagOptions(deskew=True)).notes))
    assert ("have no time_increment" if has_odometry else "can't be de-skewed without odometry") in notes
