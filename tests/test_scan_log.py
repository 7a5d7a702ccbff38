"""A log from arrays: what comes out is what went in, and what is wrong is said with its place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mapmend

N, BEAMS = 4, 6
ANGLES = np.linspace(-1.0, 1.0, BEAMS)
RANGES = 1.0 + np.arange(N * BEAMS, dtype=np.float64).reshape(N, BEAMS)
LASER = mapmend.LaserGeometry(BEAMS, -1.0, 0.4, 30.0)


def test_a_log_holds_what_was_given():
    ranges = RANGES.copy()
    ranges[1, 2], ranges[2, 3] = np.inf, np.nan
    stamps, odometry = np.array([0.0, 0.1, 0.1, 0.5]), np.random.default_rng(0).normal(size=(N, 3))
    log = mapmend.ScanLog.from_arrays(ranges, geometry=LASER, stamps_s=stamps, odometry=odometry)
    assert (len(log), log.has_stamps, log.has_odometry) == (N, True, True)
    np.testing.assert_array_equal([log.scans.ranges_of(k) for k in range(N)], ranges.astype(np.float32))
    np.testing.assert_array_equal(log.stamps_s, stamps)
    np.testing.assert_array_equal(log.odometry, odometry)
    odometry[0] = stamps[0] = 9.0  # the log keeps its own
    assert (log.odometry[0, 0], log.stamps_s[0]) != (9.0, 9.0)


@given(st.integers(2, 1500), st.floats(-3.2, 3.2), st.floats(1e-3, 6.3), st.booleans())
def test_angles_and_geometry_are_the_same_laser(beams, first, width, turns_right):
    step = (-width if turns_right else width) / (beams - 1)
    angles = first + step * np.arange(beams)
    ranges = np.ones((1, beams))
    (laser,) = mapmend.ScanLog.from_arrays(ranges, angles_rad=angles, max_range_m=8.0).scans.geometries
    np.testing.assert_allclose(laser.bearings_rad(), angles, atol=1e-12 * beams)
    single = mapmend.ScanLog.from_arrays(ranges, angles_rad=angles.astype(np.float32), max_range_m=8.0)
    np.testing.assert_allclose(single.scans.geometries[0].bearings_rad(), angles, atol=1e-6)


def test_without_stamps_and_odometry_the_log_says_so():
    log = mapmend.ScanLog.from_arrays(RANGES, angles_rad=ANGLES, max_range_m=30.0)
    assert (log.has_stamps, log.has_odometry) == (False, False)
    np.testing.assert_array_equal(log.stamps_s, np.arange(N))


def test_a_log_from_arrays_is_mapped_as_the_one_that_was_read(simulation):
    read, part = simulation.log, slice(0, 40)
    ranges = read.scans.ranges_m.reshape(len(read), -1)[part]
    (laser,) = read.scans.geometries
    made = mapmend.ScanLog.from_arrays(
        ranges, geometry=laser, stamps_s=read.stamps_s[part], odometry=read.odometry[part]
    )
    result = mapmend.build_map(made, "scanmatch")
    assert len(result.trajectory) == 40
    assert np.hypot(*(result.trajectory.poses[-1] - result.trajectory.poses[0])[:2]) > 1.0


def with_one(value, row=2, beam=4):
    ranges = RANGES.copy()
    ranges[row, beam] = value
    return ranges


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"geometry": None}, "give either geometry or angles_rad"),
        ({"angles_rad": ANGLES}, "give either geometry or angles_rad"),
        ({"geometry": None, "angles_rad": ANGLES}, "angles_rad needs max_range_m"),
        ({"max_range_m": 8.0}, "the geometry says max_range_m"),
        ({"geometry": None, "angles_rad": [0.0, 0.1, 0.3, 0.4, 0.5, 0.6], "max_range_m": 8.0}, "evenly spaced; beam 2"),
        ({"geometry": None, "angles_rad": [0.0] * BEAMS, "max_range_m": 8.0}, "evenly spaced"),
        ({"geometry": None, "angles_rad": [[0.0, 1.0]], "max_range_m": 8.0}, "of shape \\(beams,\\)"),
        ({"ranges_m": RANGES[:, :5]}, "ranges_m must have shape \\(n, 6\\), got \\(4, 5\\)"),
        ({"ranges_m": RANGES[0]}, "ranges_m must have shape"),
        ({"ranges_m": [[1.0] * 6, [1.0] * 5]}, "ranges_m must be numbers, as many in each scan"),
        ({"ranges_m": with_one(0.0)}, "scan 2, beam 4: 0; a range is positive, inf"),
        ({"ranges_m": with_one(-np.inf)}, "scan 2, beam 4: -inf"),
        ({"stamps_s": [0.0, 1.0]}, "stamps_s must have shape \\(4,\\)"),
        ({"stamps_s": [0.0, 2.0, 1.0, 3.0]}, "stamps_s must not fall; that of scan 2 is 1 after 2"),
        ({"stamps_s": [0.0, 1.0, np.nan, 3.0]}, "must be finite"),
        ({"odometry": np.zeros((4, 2))}, "odometry must have shape \\(4, 3\\)"),
        ({"odometry": np.full((4, 3), np.inf)}, "must be finite"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(arguments, complaint):
    given_arguments = {"ranges_m": RANGES, "geometry": LASER, **arguments}
    with pytest.raises(mapmend.MapmendError, match=complaint):
        mapmend.ScanLog.from_arrays(given_arguments.pop("ranges_m"), **given_arguments)
