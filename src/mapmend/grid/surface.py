"""The grid that scans are matched on: cells that hold the surface seen in them, in tiles that grow with the
building."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.grid import _kernels
from mapmend.grid._kernels import TILE_CELLS, Clearing, Room, Tiles

Float = NDArray[np.float64]

# How many returns the mean of a cell remembers.
MEAN_MEMORY = _kernels.MEAN_MEMORY

FIRST_TILES = 64
# Every third beam clears: a share of the beams, not an angle, since each beam that returns counts for its surface. With
# an angle (12 of 1,441 beams instead of 3), the grid forgets too slowly (docs/decisions/058).
CLEARING_STRIDE = 3


class SurfaceGrid:
    """Cells of ``cell_size_m``, each with the mean position and normal of its returns and with the beams' passes.

    Tiles of 32 x 32 cells are taken into use where beams went, so memory follows the area that was seen. Every cell
    also knows the nearest surface within four cells: matching looks it up. ``tiles``: its arrays, for kernels.
    """

    def __init__(self, cell_size_m: float = 0.05, clearing_stride: int = CLEARING_STRIDE) -> None:
        self.cell_size_m = float(cell_size_m)
        table = np.full((8, 8), -1, dtype=np.int32)
        self.tiles = self._new_tiles(table, np.array([0, -4, -4], dtype=np.int64), FIRST_TILES)
        self._clearing = Clearing(0, clearing_stride)

    def _new_tiles(self, table: NDArray[np.int32], frame: NDArray[np.int64], tiles: int) -> Tiles:
        """Empty cells for this many tiles."""
        cells = tiles * TILE_CELLS
        return Tiles(
            table,
            frame,
            surface=np.zeros((cells, 5), dtype=np.float32),
            returns=np.zeros(cells, dtype=np.uint8),
            evidence=np.zeros(cells, dtype=np.int8),
            nearest=np.full(cells, -1, dtype=np.int32),
            references=None,
            cell_size_m=self.cell_size_m,
        )

    def clear(self) -> None:
        """Removes all content and keeps the memory."""
        tiles = self.tiles
        tiles.table.fill(-1)
        used = int(tiles.frame[0]) * TILE_CELLS
        tiles.frame[0] = 0
        self._clearing = Clearing(0, self._clearing.stride)
        tiles.surface[:used] = 0.0
        tiles.returns[:used] = 0
        tiles.evidence[:used] = 0
        tiles.nearest[:used] = -1

    def _make_room(self, room: Room) -> None:
        """Grows the table over a box of tiles, and the arrays by as many tiles as the box may need."""
        old = self.tiles
        rows, columns = old.table.shape
        top, left = int(old.frame[1]), int(old.frame[2])
        bottom, right = top + rows, left + columns
        # A half more on the side that was too small, so that the table does not have to grow often.
        new_top = min(top, room.first_row - rows // 2) if room.first_row < top else top
        new_left = min(left, room.first_column - columns // 2) if room.first_column < left else left
        new_bottom = max(bottom, room.last_row + 1 + rows // 2) if room.last_row >= bottom else bottom
        new_right = max(right, room.last_column + 1 + columns // 2) if room.last_column >= right else right
        if (new_top, new_left, new_bottom, new_right) != (top, left, bottom, right):
            table = np.full((new_bottom - new_top, new_right - new_left), -1, dtype=np.int32)
            table[top - new_top : bottom - new_top, left - new_left : right - new_left] = old.table
            old.frame[1:] = (new_top, new_left)
            self.tiles = old = old._replace(table=table)
        have = len(old.returns) // TILE_CELLS
        asked = (room.last_row - room.first_row + 1) * (room.last_column - room.first_column + 1)
        wanted = int(old.frame[0]) + asked
        if wanted > have:
            used = int(old.frame[0]) * TILE_CELLS
            self.tiles = self._new_tiles(old.table, old.frame, max(wanted, have + have // 2))
            self.tiles.surface[:used] = old.surface[:used]
            self.tiles.returns[:used] = old.returns[:used]
            self.tiles.evidence[:used] = old.evidence[:used]
            self.tiles.nearest[:used] = old.nearest[:used]

    def insert(self, points: Float, laser_origin: Float, pose: Float) -> None:
        """Adds a scan: ``points`` (n, 5) from `project_scan`, the laser's position on the robot, ``T_grid_robot``."""
        if len(points) == 0:
            return
        room = _kernels.find_room(self.tiles, points, laser_origin, pose)
        if not room.is_there:
            self._make_room(room)
        _kernels.insert_points(self.tiles, points, laser_origin, pose, self._clearing)
        first, stride = self._clearing
        self._clearing = Clearing((first + 1) % stride, stride)
