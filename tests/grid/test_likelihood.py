"""The likelihood field against its plain twin, and its bounds against what they bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.grid.likelihood import likelihood_field
from mapmend.grid.surface import SurfaceGrid
from tests.grid.contents import Contents
from tests.reference.likelihood import likelihood

SIZE = 0.05


def grid_of(seed, returns=12, spread_m=2.5):
    """A grid of single returns: the nearest surface of a cell is the nearest of all."""
    rng = np.random.default_rng(seed)
    grid = SurfaceGrid(SIZE)
    points = np.zeros((returns, 5))
    points[:, :2] = rng.uniform(-spread_m, spread_m, (returns, 2))
    grid.insert(points, points[0, :3] * (1.0, 1.0, 0.0), np.array([*rng.uniform(-9.0, 9.0, 2), 0.0]))
    return grid


def test_the_finest_level_is_that_of_the_plain_twin():
    grid = grid_of(1)
    field = likelihood_field(grid.tiles, 0.1)
    means = Contents(grid).mean
    assert field.cell_size_m == 2 * SIZE
    column0, row0 = (round(x / field.cell_size_m) for x in field.origin)
    rows, columns = field.levels[0].shape
    expected = np.zeros((rows, columns))
    # Cells without any return within reach are 0 in both: only those around the returns are computed one by one.
    near = {(r // 2 + a, c // 2 + b) for r, c in means for a in range(-3, 4) for b in range(-3, 4)}
    for row, column in near:
        expected[row - row0, column - column0] = likelihood(means, row, column, SIZE, 0.1)
    np.testing.assert_allclose(field.levels[0].astype(float), expected, atol=1.0)
    assert field.levels[0].max() > 200


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_every_level_bounds_all_offsets_that_begin_in_one_block(seed):
    field = likelihood_field(grid_of(seed).tiles, 0.1)
    finest = field.levels[0].astype(int)
    for shift, level in enumerate(field.levels[1:], 1):
        width = 1 << shift
        assert level.shape == (finest.shape[0] >> shift, finest.shape[1] >> shift)
        padded = np.pad(finest, ((0, width), (0, width)))
        for dy in range(width):
            for dx in range(width):
                moved = padded[dy : dy + finest.shape[0], dx : dx + finest.shape[1]]
                block = moved.reshape(level.shape[0], width, level.shape[1], width).max(axis=(1, 3))
                assert np.all(level >= block)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_bounds_are_no_looser_than_twice_the_block(seed):
    field = likelihood_field(grid_of(seed).tiles, 0.1)
    finest = field.levels[0]
    for shift, level in enumerate(field.levels[1:], 1):
        width = 1 << shift
        blocks = np.pad(finest, ((0, width), (0, width)))
        for row, column in np.argwhere(level)[::7]:
            part = blocks[row * width : (row + 2) * width, column * width : (column + 2) * width]
            assert level[row, column] == part.max()


def test_nothing_likely_lies_on_the_rim_where_offsets_from_outside_begin():
    field = likelihood_field(grid_of(2).tiles, 0.1)
    rim = 1 << (len(field.levels) - 1)
    assert not field.levels[0][:rim].any()
    assert not field.levels[0][:, :rim].any()


@pytest.mark.parametrize("centre", [(0.0, 0.0), (-3.3, 2.1), (7.0, 7.0)])
def test_a_part_of_the_field_is_that_part_of_the_whole(centre):
    grid = SurfaceGrid(SIZE)
    rng = np.random.default_rng(9)
    points = np.zeros((200, 5))
    points[:, :2] = rng.uniform(-12.0, 12.0, (200, 2))
    grid.insert(points, np.zeros(3), np.zeros(3))
    whole, part = likelihood_field(grid.tiles, 0.1), likelihood_field(grid.tiles, 0.1, centre, 2.0)
    assert part.levels[0].size < 0.3 * whole.levels[0].size

    def at(field, x, y):
        column, row = (int((a - o) // field.cell_size_m) for a, o in zip((x, y), field.origin, strict=True))
        rows, columns = field.levels[0].shape
        return int(field.levels[0][row, column]) if 0 <= row < rows and 0 <= column < columns else 0

    places = centre + np.random.default_rng(3).uniform(-2.0, 2.0, (2000, 2))
    values = [at(whole, x, y) for x, y in places]
    assert max(values) > 100
    assert [at(part, x, y) for x, y in places] == values


def test_the_field_of_nothing_is_empty():
    for field in (
        likelihood_field(SurfaceGrid(SIZE).tiles, 0.1),
        likelihood_field(grid_of(4).tiles, 0.1, (500.0, 500.0), 3.0),
    ):
        assert all(not level.any() for level in field.levels)
        assert field.cell_size_m == 2 * SIZE
