"""Scans projected to points with normals, against the plain twin, and which of the points are thin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.grid._projection_kernels import Laser
from mapmend.grid._projection_kernels import project_scan as compiled_project_scan
from tests.reference.surface_grid import project_scan

readings = st.one_of(st.floats(0.0625, 12.0, width=32), st.sampled_from([np.inf, np.nan, 0.03125]))


@settings(max_examples=200, deadline=None)
@given(
    st.lists(readings, max_size=12).flatmap(
        lambda some: st.tuples(st.just(some), st.lists(st.floats(-0.02, 0.02), min_size=len(some), max_size=len(some)))
    ),
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4)),
    st.sampled_from(["any", "round", "wall", "posts"]),
    st.floats(-0.37, 0.37),
    st.integers(1, 3),
    st.sampled_from([0.0, 2.0, 20.0]),
)
def test_projected_points_and_normals_are_those_of_the_plain_twin(drawn, mounting, kind, slant, away, away_m):
    ranges, noise = drawn
    bearings = -1.0 + 0.2 * np.arange(len(ranges))
    if kind != "any" and ranges:
        near = ranges[0] * (1.0 + np.array(noise))
        if kind == "round":  # a surface: neighbours belong together
            ranges = near
        elif kind == "wall":  # so they do far apart where they lie on a line
            ranges = ranges[0] / np.cos(bearings - slant) + 2.0 * np.array(noise)
        else:  # something near here and there, before what is behind
            ranges = np.where(np.array(ranges) > 3.0, ranges[0] + 4.0, near)
    ranges = np.array(ranges, dtype=np.float32)
    limits = (0.05, 10.0, 0.1, 0.03, away, float(away_m))
    expected = project_scan([float(r) for r in ranges], bearings, limits, mounting)
    points = np.full((len(ranges), 5), 7.0)
    count = compiled_project_scan(ranges, laser(bearings, limits, mounting), points)
    assert count == len(expected)
    np.testing.assert_allclose(points[:count], np.array(expected).reshape(-1, 5), atol=1e-9)


def test_normals_of_a_wall_look_at_the_laser():
    bearings = np.radians(np.arange(-60.0, 61.0))
    points = projected(2.0 / np.cos(bearings), bearings)
    np.testing.assert_allclose(points[1:-1, 2:4], np.tile([-1.0, 0.0], (len(bearings) - 2, 1)), atol=1e-5)
    assert np.all(points[[0, -1], 2:4] == 0.0)


def laser(bearings, limits, mounting=(0.0, 0.0, 0.0)):
    """A `Laser`; ``limits`` are its fields after the mounting."""
    return Laser(np.cos(bearings), np.sin(bearings), np.array(mounting), *limits)


def projected(ranges, bearings):
    """The points of a laser in the robot's centre; a row for every reading, none of which may be left out."""
    points = np.full((len(bearings), 5), 7.0)
    limits = (0.05, 100.0, 0.1, 0.03, 1, 0.0)
    ranges = np.array(ranges, dtype=np.float32)
    count = compiled_project_scan(ranges, laser(bearings, limits), points)
    assert count == np.isfinite(ranges).sum()
    return points[:count]


def test_a_wall_at_a_grazing_angle_has_normals_as_far_as_its_points_are_not_metres_apart():
    """Beside the robot, one metre away, seen at 60 down to 3 degrees: from 15 degrees on, neighbours differ by 0.1."""
    degrees = np.arange(60, 2, -1)
    bearings = np.radians(degrees)
    points = projected(1.0 / np.sin(bearings), bearings)
    ends = np.isin(degrees, (60, 3))
    dense = degrees >= 5  # at 4 degrees, the neighbours are 7.6 m apart
    wall = dense & ~ends
    np.testing.assert_allclose(points[wall, 2:4], np.tile([0.0, -1.0], (wall.sum(), 1)), atol=1e-4)
    assert np.all(points[~wall, 2:4] == 0.0)
    noisy = projected(1.0 / np.sin(bearings) + 0.01 * np.cos(7.0 * degrees), bearings)
    grazing = wall & (degrees < 15)
    assert np.all(noisy[grazing, 3] < -0.99)


@pytest.mark.parametrize(
    "middle",
    [
        (2.0, 4.0, 6.0),  # stairs of three surfaces, each behind the other
        (2.0, 2.0, 6.0),  # the last of a surface before what lies behind
        (6.0, 2.0, 6.0),
        (2.0, 6.0, 2.0),
        (6.0, 6.0, np.inf),
        (2.0, np.inf, 6.0),
    ],
)
def test_what_lies_on_no_line_with_its_neighbours_has_no_normal(middle):
    """Two degrees apart: the stairs' middle is 7 cm off the line of its neighbours."""
    bearings = np.radians(np.arange(3) * 2.0 + 40.0)
    rows = np.zeros((3, 5))
    seen = laser(bearings, (0.05, 30.0, 0.1, 0.03, 1, 0.0))
    count = compiled_project_scan(np.array(middle, dtype=np.float32), seen, rows)
    assert np.all(rows[:count, 2:4] == 0.0)


def thin(ranges):
    """Which readings of a laser of one beam a degree are thin, by their numbers."""
    ranges = np.array(ranges, dtype=float)
    bearings = np.radians(np.arange(len(ranges)) - 45.0)
    numbers = np.flatnonzero(np.isfinite(ranges))
    column = projected(ranges, bearings)[:, 4]
    assert set(column) <= {0.0, 1.0}
    return numbers[column == 1.0].tolist()


def with_something(behind_m, first, width, range_m):
    ranges = np.full(90, behind_m)
    ranges[first : first + width] = range_m
    return ranges


@pytest.mark.parametrize("behind_m", [6.0, np.inf])
@pytest.mark.parametrize("width", [1, 2, 3, 4])
def test_a_post_or_a_leg_is_thin(behind_m, width):
    assert thin(with_something(behind_m, 40, width, 2.0)) == list(range(40, 40 + width))


@pytest.mark.parametrize("width", [5, 14, 40])
def test_a_wide_box_is_not_thin(width):
    assert thin(with_something(6.0, 40, width, 2.0)) == []


def test_two_legs_of_a_person_are_both_thin():
    ranges = with_something(6.0, 40, 2, 2.0)
    ranges[44:46] = 2.1
    assert thin(ranges) == [40, 41, 44, 45]


@pytest.mark.parametrize("behind_m", [np.inf, 40.0])
@pytest.mark.parametrize("last_degrees", [3, 20])
def test_the_last_point_of_a_wall_is_not_thin(behind_m, last_degrees):
    """Beside the robot, out to where the laser sees no more of it, or to its end."""
    degrees = np.arange(90, 0, -1)
    ranges = np.where(degrees >= last_degrees, 1.0 / np.sin(np.radians(degrees)), behind_m)
    assert thin(ranges) == []
    assert thin(ranges[::-1]) == []


def test_what_has_something_nearer_beside_it_or_the_end_of_the_scan_is_not_thin():
    """A piece of wall seen past a door's edge goes on behind it, and so may what the scan ends in."""
    gap = with_something(2.0, 40, 2, 6.0)
    assert thin(gap) == []
    half_hidden = with_something(6.0, 40, 2, 3.0)
    half_hidden[20:40] = 2.0
    assert thin(half_hidden) == []
    assert thin(with_something(6.0, 0, 2, 2.0)) == []
    assert thin(with_something(6.0, 88, 2, 2.0)) == []
    lost = with_something(6.0, 40, 2, 2.0)
    lost[39] = np.nan  # nobody knows what is there
    assert thin(lost) == []
