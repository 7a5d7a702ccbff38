"""A log's scans as points: what is left out, and where the laser stands."""

import numpy as np
import pytest

from mapmend.config import ScanConfig
from mapmend.scan import LaserGeometry, Scans
from mapmend.scan_graph.points import ScanPoints, neighbours_away

FRONT = LaserGeometry(3, -0.5, 0.5, 5.0, (1.0, 0.0, 0.0))
REAR = LaserGeometry(5, -1.0, 0.5, 50.0, (-1.0, 0.5, np.pi))


def two_lasers(front, rear):
    ranges = np.array([*front, *rear], dtype=np.float32)
    return Scans(ranges, np.array([0, 3, 8]), np.array([0, 1], np.int32), (FRONT, REAR))


def test_each_scan_is_projected_with_its_own_laser():
    points = ScanPoints(two_lasers([2.0] * 3, [3.0] * 5), ScanConfig())
    front = points.of(0).copy()
    assert front[1, :2] == pytest.approx([3.0, 0.0])
    assert points.of(1)[2, :2] == pytest.approx([-4.0, 0.5])
    np.testing.assert_array_equal(points.of(0), front)
    assert points.laser_origin(1)[:2] == pytest.approx([-1.0, 0.5])


def test_no_returns_and_readings_beyond_either_longest_range_are_left_out():
    points = ScanPoints(
        two_lasers([2.0, np.inf, 5.5], [np.nan, 0.01, 20.0, 45.0, 2.0]), ScanConfig(min_range_m=0.05, max_range_m=30.0)
    )
    assert len(points.of(0)) == 1
    assert len(points.of(1)) == 2


def test_a_scan_without_readings_has_no_points():
    scans = Scans(np.zeros(0, np.float32), np.array([0, 0]), np.zeros(1, np.int32), (FRONT,))
    assert ScanPoints(scans, ScanConfig()).of(0).shape == (0, 5)


@pytest.mark.parametrize(
    ("increment_deg", "least", "at_2_m"), [(2.0, 1, 0), (1.0, 1, 0), (0.5, 1, 0), (0.25, 2, 11), (-0.125, 4, 22)]
)
def test_neighbours_of_dense_lasers_are_a_tenth_of_a_metre_away(increment_deg, least, at_2_m):
    away, times_range = neighbours_away(LaserGeometry(9, 0.0, np.radians(increment_deg), 30.0))
    assert away == least
    assert int(times_range / 2.0) == at_2_m


def test_normals_of_a_dense_laser_are_not_those_of_its_noise():
    """A wall 2 m ahead, eight beams a degree, 2 cm of noise: next neighbours are 4 mm apart."""
    geometry = LaserGeometry(481, np.radians(-30.0), np.radians(0.125), 30.0)
    noise = np.random.default_rng(0).normal(scale=0.02, size=481)
    ranges = (2.0 / np.cos(geometry.bearings_rad()) + noise).astype(np.float32)
    scans = Scans(ranges, np.array([0, 481]), np.zeros(1, np.int32), (geometry,))
    normals = ScanPoints(scans, ScanConfig()).of(0)[:, 2:4]
    known = normals.any(axis=1)
    assert known[23:-23].mean() > 0.95
    assert np.median(np.abs(normals[known, 1])) < 0.12  # between next neighbours 0.9; at one beam a degree 0.3
