"""The content of a surface grid, by the cells' row and column, independent of the numbers of its tiles."""

import numpy as np

from mapmend.grid._kernels import TILE, TILE_CELLS


class Contents:
    """``mean``, ``returns``, ``evidence`` and ``nearest`` by (row, column); cells that hold the initial value left out.

    ``nearest`` names the (row, column) of the cell that is pointed at.
    """

    def __init__(self, grid):
        tiles = grid.tiles
        surface, returns, evidence, nearest = tiles.surface, tiles.returns, tiles.evidence, tiles.nearest
        self.cells_of_tiles = {}
        rows, columns = np.nonzero(tiles.table >= 0)
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            corner = ((row + int(tiles.frame[1])) * TILE, (column + int(tiles.frame[2])) * TILE)
            self.cells_of_tiles[int(tiles.table[row, column])] = corner
        self.mean, self.returns, self.evidence, self.nearest = {}, {}, {}, {}
        for tile in self.cells_of_tiles:
            part = slice(tile * TILE_CELLS, (tile + 1) * TILE_CELLS)
            for k in np.nonzero((returns[part] != 0) | (evidence[part] != 0) | (nearest[part] >= 0))[0].tolist():
                number = tile * TILE_CELLS + k
                cell = self.cell(number)
                if returns[number]:
                    self.mean[cell] = tuple(surface[number].tolist())
                    self.returns[cell] = int(returns[number])
                if evidence[number]:
                    self.evidence[cell] = int(evidence[number])
                if nearest[number] >= 0:
                    self.nearest[cell] = self.cell(int(nearest[number]))

    def cell(self, number):
        tile, k = divmod(number, TILE_CELLS)
        row, column = self.cells_of_tiles[tile]
        return row + k // TILE, column + k % TILE

    def __eq__(self, other):
        mine = (self.mean, self.returns, self.evidence, self.nearest)
        return mine == (other.mean, other.returns, other.evidence, other.nearest)

    __hash__ = None


def around(cells, reach):
    """All cells within ``reach`` cells of any of ``cells``."""
    steps = range(-reach, reach + 1)
    return {(r + dr, c + dc) for r, c in cells for dr in steps for dc in steps}
