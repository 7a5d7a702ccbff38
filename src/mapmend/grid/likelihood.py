"""The likelihood of a return in every cell of a part of a grid, and its pyramid of upper bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.grid import _kernels

Bytes = NDArray[np.uint8]
Tiles = _kernels.Tiles

LEVELS = 6
# Tiles under one cell of the coarsest level.
TILES_ACROSS = 2 << (LEVELS - 1) >> _kernels.TILE_BITS


@dataclass(frozen=True)
class LikelihoodField:
    """``levels``: uint8 arrays in cells of 1, 2, 4, 8, 16, 32 times ``cell_size_m``; 255 is a certain return.

    Its cells are twice as wide as the grid's, because the pose found is refined on the surfaces themselves.

    Cell (row, column) of the finest level covers ``origin + (column, row) * cell_size_m`` onwards (metres, grid frame).
    A cell of level h is an upper bound for all finest cells from its corner on over twice its width, so that one
    look-up bounds all whole-cell offsets that begin in one block.
    """

    levels: tuple[Bytes, ...]
    origin: tuple[float, float]
    cell_size_m: float


def likelihood_field(
    tiles: Tiles, std_m: float, centre: tuple[float, float] | None = None, radius_m: float = np.inf
) -> LikelihoodField:
    """The field of those ``tiles`` that touch the square of ``radius_m`` about ``centre`` (all, by default).

    A cell's likelihood is ``exp(-d^2 / (2 std_m^2))`` with d from its centre to the nearest surface within reach.
    """
    size, tile = tiles.cell_size_m, _kernels.TILE
    row0, column0 = int(tiles.frame[1]), int(tiles.frame[2])
    rows, columns = tiles.table.shape
    if centre is not None and np.isfinite(radius_m):
        span = tile * size
        first_c = max(int((centre[0] - radius_m) // span) - column0, 0)
        last_c = min(int((centre[0] + radius_m) // span) - column0 + 1, columns)
        first_r = max(int((centre[1] - radius_m) // span) - row0, 0)
        last_r = min(int((centre[1] + radius_m) // span) - row0 + 1, rows)
    else:
        first_r, last_r, first_c, last_c = 0, rows, 0, columns
    part = tiles.table[first_r : max(last_r, first_r), first_c : max(last_c, first_c)]
    used_r, used_c = np.nonzero(part >= 0)
    if len(used_r) == 0:
        empty = np.zeros((1, 1), np.uint8)
        return LikelihoodField((empty,) * LEVELS, (0.0, 0.0), 2.0 * size)
    # Empty tiles before the first one: the bounds of offsets that begin outside must include the cells that they reach.
    low_r, low_c = int(used_r.min()) - TILES_ACROSS, int(used_c.min()) - TILES_ACROSS
    shape = [
        -(-(int(last) - low + 1) // TILES_ACROSS) * TILES_ACROSS
        for last, low in ((used_r.max(), low_r), (used_c.max(), low_c))
    ]
    finest = np.zeros((shape[0], tile, shape[1], tile), np.uint8)
    numbers = part[used_r, used_c]
    names = tiles.nearest.reshape(-1, tile, tile)[numbers]
    # Few cells are near a surface: the exponential is computed only for those.
    t, row, column = np.nonzero(names >= 0 if tiles.references is None else names)
    row_on_map, column_on_map = (
        (used_r[t] + first_r + row0) * tile + row,
        (used_c[t] + first_c + column0) * tile + column,
    )
    sources = names[t, row, column]
    if tiles.references is not None:
        cells = numbers[t].astype(np.int64) * _kernels.TILE_CELLS + row * tile + column
        sources = _kernels.nearest_surfaces(tiles, cells, row_on_map, column_on_map)
    means = tiles.surface[sources, :2]
    x, y = (column_on_map + 0.5) * size, (row_on_map + 0.5) * size
    squared = (means[:, 0] - x) ** 2 + (means[:, 1] - y) ** 2
    finest[used_r[t] - low_r, row, used_c[t] - low_c, column] = np.rint(255.0 * np.exp(-squared / (2.0 * std_m**2)))
    blocks = _halved(finest.reshape(shape[0] * tile, shape[1] * tile))
    levels = [blocks]
    for _ in range(LEVELS - 1):
        blocks = _halved(blocks)
        levels.append(_reaching_over(blocks))
    origin = ((first_c + low_c + column0) * tile * size, (first_r + low_r + row0) * tile * size)
    return LikelihoodField(tuple(levels), origin, 2.0 * size)


def _halved(cells: Bytes) -> Bytes:
    """The maximum of every 2 x 2 cells."""
    return np.maximum(np.maximum(cells[::2, ::2], cells[1::2, ::2]), np.maximum(cells[::2, 1::2], cells[1::2, 1::2]))


def _reaching_over(blocks: Bytes) -> Bytes:
    """The maximum of each block and its neighbours to the right, above and diagonally: all that an offset can reach."""
    wide = blocks.copy()
    wide[:, :-1] = np.maximum(blocks[:, :-1], blocks[:, 1:])
    tall = wide.copy()
    tall[:-1] = np.maximum(wide[:-1], wide[1:])
    return tall
