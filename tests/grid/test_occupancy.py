"""The occupancy map: against its plain twin, and on cases with a known answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.config import GridConfig, ScanConfig
from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose
from mapmend.grid import occupancy
from mapmend.grid._kernel_types import MapFrame
from mapmend.grid.occupancy import occupancy_map
from mapmend.maps import FREE, OCCUPIED, UNKNOWN
from mapmend.scan import LaserGeometry, Scans
from tests.reference.occupancy_counts import count_beams

CONFIG = ScanConfig(min_range_m=0.05, max_range_m=4.0)
FINE, COARSE = GridConfig(), GridConfig(cell_size_m=0.1)
# Bearings and mountings that put no beam's end exactly on the edge of a cell, where rounding decides.
GEOMETRY = LaserGeometry(7, -1.5123, 0.5077, 10.0, (0.1213, 0.0371, 0.1))


def one_geometry(ranges, geometry=GEOMETRY):
    rows = np.atleast_2d(np.asarray(ranges, dtype=np.float32))
    offsets = np.arange(len(rows) + 1, dtype=np.int64) * rows.shape[1]
    return Scans(rows.ravel(), offsets, np.zeros(len(rows), np.int32), (geometry,))


def counts_of(scans, poses, cell_size_m):
    """The kernel's counts over the whole map, band by band, and the map's origin and shape."""
    beams = occupancy._place(scans, poses, CONFIG)
    cell, shape = occupancy._extent(beams, cell_size_m)
    origin = (cell[0] * cell_size_m, cell[1] * cell_size_m)
    frame = MapFrame(*(float(value) for value in (*origin, cell_size_m, CONFIG.min_range_m, CONFIG.max_range_m)))
    bands = [occupancy._count(beams, frame, row, (min(5, shape[0] - row), shape[1])) for row in range(0, shape[0], 5)]
    return np.concatenate(bands, axis=1), origin, shape


readings = st.one_of(st.floats(0.0625, 6.0, width=32), st.sampled_from([np.inf, np.nan, 0.0399]))
poses = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.1, 3.1))


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(poses, st.lists(readings, min_size=7, max_size=7)), min_size=1, max_size=4))
def test_counts_are_those_of_the_plain_twin(rows):
    scans = one_geometry([r for _, r in rows])
    robot = np.array([p for p, _ in rows])
    counts, origin, shape = counts_of(scans, robot, 0.2)
    laser = compose(robot, np.array(GEOMETRY.T_robot_laser))
    returns, passes = count_beams(scans, laser.tolist(), CONFIG, origin, 0.2, shape)
    # A place on the edge of two cells may round to either; anything else must agree to the last beam.
    in_cells = np.concatenate(list(occupancy._ends(occupancy._place(scans, robot, CONFIG)))) / 0.2
    if np.abs(in_cells - np.rint(in_cells)).min() > 1e-9:
        np.testing.assert_array_equal(counts, [returns, passes])


def test_the_same_bytes_for_any_number_of_threads_and_bands(monkeypatch):
    rng = np.random.default_rng(1)
    scans = one_geometry(rng.uniform(0.1, 5.0, (200, 7)))
    robot = rng.uniform((-20, -20, -3), (20, 20, 3), (200, 3))
    first = occupancy_map(scans, robot, CONFIG, FINE, threads=1)
    second = occupancy_map(scans, robot, CONFIG, FINE, threads=3)
    monkeypatch.setattr(occupancy, "BAND_ROWS", 17)
    third = occupancy_map(scans, robot, CONFIG, FINE, threads=2)
    assert first.origin == second.origin == third.origin
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.image, third.image)


def cell_at(grid, x, y):
    row, column = int((y - grid.origin[1]) // grid.resolution_m), int((x - grid.origin[0]) // grid.resolution_m)
    return grid.image[row, column] if 0 <= row < grid.image.shape[0] and 0 <= column < grid.image.shape[1] else UNKNOWN


AHEAD = LaserGeometry(1, 0.0, 0.1, 100.0)


def test_a_beam_clears_up_to_its_return_and_says_nothing_beyond():
    grid = occupancy_map(one_geometry([[2.02]], AHEAD), np.zeros((1, 3)), CONFIG, COARSE)
    assert [cell_at(grid, x, 0.05) for x in (0.05, 1.95, 2.05, 2.15)] == [FREE, FREE, OCCUPIED, UNKNOWN]
    assert grid.origin[0] == pytest.approx(round(grid.origin[0] / 0.1) * 0.1)


def test_a_reading_beyond_the_longest_range_clears_and_marks_nothing():
    grid = occupancy_map(one_geometry([[60.0]], AHEAD), np.zeros((1, 3)), CONFIG, COARSE)
    assert cell_at(grid, 3.85, 0.05) == FREE
    assert not np.any(grid.image == OCCUPIED)
    assert grid.image.shape[1] < 50


def test_a_beam_without_return_says_nothing():
    grid = occupancy_map(one_geometry([[np.inf]], AHEAD), np.zeros((1, 3)), CONFIG, COARSE)
    assert np.all(grid.image == UNKNOWN)


def test_who_walked_through_is_not_in_the_map():
    grid = occupancy_map(one_geometry([[2.02]] * 20 + [[1.02]] * 2, AHEAD), np.zeros((22, 3)), CONFIG, COARSE)
    assert cell_at(grid, 1.05, 0.05) == FREE
    assert cell_at(grid, 2.05, 0.05) == OCCUPIED


def test_two_lasers_of_different_beam_counts():
    rear = LaserGeometry(2, np.pi, 0.2, 100.0, (-0.2, 0.0, 0.0))
    scans = Scans(
        np.array([1.02, 1.02, 1.02], np.float32), np.array([0, 1, 3, 3]), np.array([0, 1, 0], np.int32), (AHEAD, rear)
    )
    grid = occupancy_map(scans, np.zeros((3, 3)), CONFIG, COARSE)
    assert cell_at(grid, 1.05, 0.05) == OCCUPIED
    assert np.count_nonzero(grid.image == OCCUPIED) == 3


def test_no_scans_make_a_small_unknown_map():
    grid = occupancy_map(one_geometry(np.zeros((0, 1)), AHEAD), np.zeros((0, 3)), CONFIG, COARSE)
    assert np.all(grid.image == UNKNOWN)


def test_absurd_extents_and_bad_poses_are_refused():
    scans = one_geometry([[1.0], [1.0]], AHEAD)
    with pytest.raises(MapmendError, match="cell_size_m"):
        occupancy_map(scans, np.array([[0, 0, 0], [1e6, 1e6, 0]], dtype=float), CONFIG, FINE)
    with pytest.raises(MapmendError, match="finite"):
        occupancy_map(scans, np.array([[0, 0, 0], [np.nan, 0, 0]]), CONFIG, FINE)
    with pytest.raises(MapmendError, match="shape"):
        occupancy_map(scans, np.zeros((3, 3)), CONFIG, FINE)
