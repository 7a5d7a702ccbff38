"""The surface grid against its plain twin, and properties that hold for all input."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.geometry import se2
from mapmend.grid._kernels import Room
from mapmend.grid.surface import SurfaceGrid
from tests.grid.contents import Contents, around
from tests.reference.surface_grid import REACH, PlainGrid, nearest_distance

SIZE = 0.05
seeds = st.integers(0, 2**32 - 1)


def random_scan(rng, beams=24, far_m=3.0):
    """Points all around with normals that look roughly at the laser, some without."""
    bearings = rng.uniform(-np.pi, np.pi, beams)
    ranges = rng.uniform(0.02, far_m, beams)
    normals = bearings + np.pi + rng.uniform(-1.5, 1.5, beams)
    has_normal = rng.uniform(size=beams) < 0.8
    points = np.column_stack(
        (ranges * np.cos(bearings), ranges * np.sin(bearings), np.cos(normals), np.sin(normals), np.zeros(beams))
    )
    points[~has_normal, 2:4] = 0.0
    return points


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from([0.05, 0.2]))
def test_surfaces_returns_and_evidence_are_those_of_the_plain_twin(seed, size):
    rng = np.random.default_rng(seed)
    grid, plain = SurfaceGrid(size), PlainGrid(size)
    spots = rng.uniform((-4, -4, -3), (4, 4, 3), (3, 3))
    scans = [random_scan(rng) for _ in range(3)]
    for k in range(30):  # few scans from few spots, again and again: cells fill, free, and fill again
        points, pose = scans[rng.integers(3)], spots[rng.integers(3)]
        laser = np.array([0.1, -0.05, 0.3])
        grid.insert(points, laser, pose)
        plain.insert(points, laser, pose, k % 3, 3)
    found = Contents(grid)
    assert found.evidence == plain.evidence
    assert found.returns == plain.returns
    assert found.mean.keys() == plain.mean.keys()
    for cell, mean in plain.mean.items():
        assert found.mean[cell] == pytest.approx(mean, abs=2e-5)


def test_evidence_saturates_and_means_forget():
    grid, origin = SurfaceGrid(SIZE), np.zeros(3)
    early, late = np.array([[1.001, 0.01, -1.0, 0.0, 0.0]]), np.array([[1.049, 0.01, -1.0, 0.0, 0.0]])
    for _ in range(300):
        grid.insert(early, origin, np.zeros(3))
    for _ in range(200):
        grid.insert(late, origin, np.zeros(3))
    found = Contents(grid)
    assert found.evidence[0, 20] == 100
    assert min(found.evidence.values()) == -100
    assert found.mean[0, 20][0] == pytest.approx(1.049, abs=1e-3)


def test_a_return_without_a_normal_leaves_the_cells_direction_alone():
    grid = SurfaceGrid(SIZE)
    with_normal = np.array([[1.01, 0.01, -0.8, 0.6, 0.0]])
    without = np.array([[1.04, 0.03, 0.0, 0.0, 0.0]])
    grid.insert(with_normal, np.zeros(3), np.zeros(3))
    for _ in range(9):
        grid.insert(without, np.zeros(3), np.zeros(3))
    # Its place counts all the same.
    assert Contents(grid).mean[0, 20] == pytest.approx((1.037, 0.028, -0.8, 0.6, 1.0), abs=1e-5)


def test_the_first_normal_that_comes_is_the_cells_direction():
    grid = SurfaceGrid(SIZE)
    for _ in range(9):
        grid.insert(np.array([[1.04, 0.03, 0.0, 0.0, 0.0]]), np.zeros(3), np.zeros(3))
    assert Contents(grid).mean[0, 20] == pytest.approx((1.04, 0.03, 0.0, 0.0, 1.0), abs=1e-5)
    grid.insert(np.array([[1.04, 0.03, -0.8, 0.6, 0.0]]), np.zeros(3), np.zeros(3))
    assert Contents(grid).mean[0, 20] == pytest.approx((1.04, 0.03, -0.8, 0.6, 1.0), abs=1e-5)


def snapped(points, pose):
    """The points moved to one place in each cell that depends on the cell alone: means that never move."""
    there = se2.transform_points(pose, points[:, :2])
    cells = np.floor(there / SIZE)
    jitter = np.sin(cells * (12.9898, 78.233) + cells[:, ::-1] * (37.719, 4.581)) * 0.3
    points = points.copy()
    points[:, :2] = se2.transform_points(se2.inverse(pose), (cells + 0.5 + jitter) * SIZE)
    return points


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_nearest_is_the_nearest_of_all_while_means_stand_still(seed):
    rng = np.random.default_rng(seed)
    grid = SurfaceGrid(SIZE)
    for _ in range(40):  # in a small room: hundreds of cells become occupied, and free again
        pose = rng.uniform((-0.4, -0.4, -3), (0.4, 0.4, 3))
        grid.insert(snapped(random_scan(rng, 30, 0.8), pose), np.zeros(3), pose)
    found = Contents(grid)
    was_free_once = [cell for cell, evidence in found.evidence.items() if evidence < 0]
    assert was_free_once
    assert found.nearest.keys() == around(found.mean, REACH)
    for cell, source in found.nearest.items():
        row, column = cell
        distance = math.dist(found.mean[source][:2], ((column + 0.5) * SIZE, (row + 0.5) * SIZE))
        assert distance == pytest.approx(nearest_distance(found.mean, cell, SIZE), abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_nearest_names_an_occupied_cell_in_reach_wherever_there_is_one(seed):
    """What holds when means move: no pointer to a freed cell, none too far, none missing."""
    rng = np.random.default_rng(seed)
    grid = SurfaceGrid(SIZE)
    for _ in range(60):
        grid.insert(random_scan(rng, 30, 0.8), np.zeros(3), rng.uniform((-0.4, -0.4, -3), (0.4, 0.4, 3)))
    found = Contents(grid)
    assert found.nearest.keys() == around(found.mean, REACH)
    for (row, column), source in found.nearest.items():
        assert source in found.mean
        assert max(abs(source[0] - row), abs(source[1] - column)) <= REACH


def test_occupied_is_what_has_returns_and_evidence():
    rng = np.random.default_rng(3)
    grid = SurfaceGrid(SIZE)
    for _ in range(100):
        grid.insert(random_scan(rng, 60, 1.5), np.zeros(3), rng.uniform((-1, -1, -3), (1, 1, 3)))
    found = Contents(grid)
    assert {cell for cell, evidence in found.evidence.items() if evidence > 0} == found.mean.keys()
    for (row, column), mean in found.mean.items():
        assert (math.floor(mean[1] / SIZE + 1e-4) - row, math.floor(mean[0] / SIZE + 1e-4) - column) in (
            (0, 0),
            (1, 0),
            (0, 1),
        )


@pytest.mark.parametrize("direction", range(8))
def test_growth_in_any_direction_keeps_what_was_there(direction):
    rng = np.random.default_rng(direction)
    points, origin = random_scan(rng, 90, 5.0), np.zeros(3)
    grid = SurfaceGrid(SIZE)
    grid.insert(points, origin, np.zeros(3))
    before = Contents(grid)
    angle = direction * np.pi / 4.0
    far = np.array([60.0 * np.cos(angle), 60.0 * np.sin(angle), 1.0])
    grid.insert(points, origin, far)
    after = Contents(grid)
    for name in ("mean", "returns", "evidence", "nearest"):
        old, new = getattr(before, name), getattr(after, name)
        assert all(new[cell] == value for cell, value in old.items())
        assert len(new) > 1.7 * len(old)


def test_a_grid_that_grew_is_one_that_was_large_from_the_start():
    rng = np.random.default_rng(5)
    poses = np.column_stack((np.linspace(-40, 40, 30), 25.0 * np.sin(np.arange(30)), rng.uniform(-3, 3, 30)))
    scans = [random_scan(rng, 90, 6.0) for _ in poses]
    large, grown = SurfaceGrid(SIZE), SurfaceGrid(SIZE)
    large._make_room(Room(-60, -60, 60, 60, False))
    for scan, pose in zip(scans, poses, strict=True):
        large.insert(scan, np.zeros(3), pose)
        grown.insert(scan, np.zeros(3), pose)
    assert large.tiles.table.size > grown.tiles.table.size
    assert Contents(large) == Contents(grown)


def test_memory_follows_the_area_seen_and_not_the_time():
    rng = np.random.default_rng(6)
    grid = SurfaceGrid(SIZE)
    scans = [random_scan(rng, 90, 4.0) for _ in range(5)]
    for k in range(20):
        grid.insert(scans[k % 5], np.zeros(3), np.zeros(3))
    tiles, cells = int(grid.tiles.frame[0]), len(grid.tiles.returns)
    for k in range(300):
        grid.insert(scans[k % 5], np.zeros(3), np.zeros(3))
    assert (int(grid.tiles.frame[0]), len(grid.tiles.returns)) == (tiles, cells)


@pytest.mark.parametrize("inserted", [12, 13, 14])
def test_a_cleared_grid_holds_nothing_and_fills_as_a_new_one(inserted):
    """Whichever third of the beams was to clear next."""
    rng = np.random.default_rng(7)
    grid, new = SurfaceGrid(SIZE), SurfaceGrid(SIZE)
    for _ in range(inserted):
        grid.insert(random_scan(rng, 90, 9.0), np.zeros(3), rng.uniform(-20, 20, 3))
    grid.clear()
    assert Contents(grid).mean == {}
    assert Contents(grid).nearest == {}
    for _ in range(6):
        points, pose = random_scan(rng, 90, 9.0), rng.uniform(-20, 20, 3)
        grid.insert(points, np.zeros(3), pose)
        new.insert(points, np.zeros(3), pose)
    assert Contents(grid) == Contents(new)


def test_a_scan_without_returns_changes_nothing():
    grid = SurfaceGrid(SIZE)
    grid.insert(random_scan(np.random.default_rng(8)), np.zeros(3), np.zeros(3))
    before = Contents(grid)
    grid.insert(np.zeros((0, 5)), np.zeros(3), np.array([100.0, 100.0, 0.0]))
    assert Contents(grid) == before


def test_all_of_a_surface_that_went_away_is_withdrawn():
    """A wall of hundreds of cells that a whole scan sees through at once leaves no cell that anything points at."""
    bearings = np.linspace(-np.pi, np.pi, 36000, endpoint=False)
    ring = np.column_stack(
        (np.cos(bearings), np.sin(bearings), -np.cos(bearings), -np.sin(bearings), np.zeros(len(bearings)))
    )
    grid, pose = SurfaceGrid(SIZE), np.array([0.013, 0.027, 0.0])
    near = ring[::60] * (4.0, 4.0, 1.0, 1.0, 1.0)
    grid.insert(near, np.zeros(3), pose)
    assert len(Contents(grid).mean) > 400
    for _ in range(4):
        grid.insert(ring * (6.0, 6.0, 1.0, 1.0, 1.0), np.zeros(3), pose)
    found = Contents(grid)
    radii = [math.hypot(*mean[:2]) for mean in found.mean.values()]
    assert min(radii) > 5.5
    assert all(source in found.mean for source in found.nearest.values())
    assert found.nearest.keys() == around(found.mean, REACH)


def test_a_laser_far_from_the_robots_centre_clears_from_where_it_stands():
    grid, plain = SurfaceGrid(0.05), PlainGrid(0.05)
    laser = np.array([-30.123, -29.456, 0.0])
    points = np.array([[1.0123 + 0.1 * k, 1.0321, -0.7, -0.7, 0.0] for k in range(9)])
    grid.insert(points, laser, np.zeros(3))
    plain.insert(points, laser, np.zeros(3), 0, 3)
    found = Contents(grid)
    assert found.evidence == plain.evidence
    assert found.returns == plain.returns


@settings(max_examples=10, deadline=None)
@given(seeds, st.integers(0, 3), st.tuples(st.integers(-5, 5), st.integers(-5, 5)))
def test_a_grid_turned_by_right_angles_and_moved_by_tiles_holds_the_same(seed, quarters, tiles):
    rng = np.random.default_rng(seed)
    moved_by = np.array([tiles[0] * 32 * SIZE, tiles[1] * 32 * SIZE, quarters * np.pi / 2])
    here, there = SurfaceGrid(SIZE), SurfaceGrid(SIZE)
    for _ in range(8):
        points, pose = random_scan(rng, 60, 3.0), rng.uniform((-2, -2, -3), (2, 2, 3))
        here.insert(points, np.zeros(3), pose)
        there.insert(points, np.zeros(3), se2.compose(moved_by, pose))

    def moved(cell):
        place = (complex(cell[1] + 0.5, cell[0] + 0.5)) * 1j**quarters + 32 * complex(*tiles)
        return math.floor(place.imag), math.floor(place.real)

    a, b = Contents(here), Contents(there)
    assert {moved(cell): e for cell, e in a.evidence.items()} == b.evidence
    assert {moved(cell): n for cell, n in a.returns.items()} == b.returns
    for cell, mean in a.mean.items():
        place = se2.transform_points(moved_by, np.array([mean[:2]]))[0]
        normal = se2.transform_points(np.array([0, 0, moved_by[2]]), np.array([mean[2:4]]))[0]
        np.testing.assert_allclose(b.mean[moved(cell)], [*place, *normal, mean[4]], atol=1e-5)
