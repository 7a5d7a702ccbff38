"""One particle's map as the tests of the surface grid see a grid."""

from types import SimpleNamespace

import numpy as np

from mapmend.grid._kernels import ACROSS, REACH, TILE, TILE_CELLS
from tests.grid.contents import Contents


def contents_of(maps, p):
    """`Contents` of particle p's map: ``nearest`` by cell number instead of by offset."""
    tiles = maps.of(p)
    table, ways = tiles.table, tiles.nearest
    nearest = np.full(len(ways), -1, dtype=np.int64)
    for row, column in np.argwhere(table >= 0).tolist():
        for k in range(TILE_CELLS):
            cell = int(table[row, column]) * TILE_CELLS + k
            if ways[cell]:
                step_r, step_c = divmod(int(ways[cell]) - 1, ACROSS)
                r, c = row * TILE + k // TILE + step_r - REACH, column * TILE + k % TILE + step_c - REACH
                nearest[cell] = table[r // TILE, c // TILE] * TILE_CELLS + r % TILE * TILE + c % TILE
    return Contents(SimpleNamespace(tiles=tiles._replace(nearest=nearest)))
