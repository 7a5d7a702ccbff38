"""The grid that scans are matched on: cells that hold the surface seen in them, in tiles that grow with the
building."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.grid import _kernels

Float = NDArray[np.float64]


class SurfaceGrid:
    """Cells of ``cell_size_m``, each with the mean position and normal of its returns and with the beams' passes.

    Tiles of 32 x 32 cells are taken into use where beams went, so memory follows the area that was seen. Every cell
    also knows the nearest surface within four cells: matching looks it up.
    """

    def __init__(self, cell_size_m: float = 0.05) -> None:
        self.cell_size_m = cell_size_m
        self.table = np.full((8, 8), -1, dtype=np.int32)
        # Tiles in use, first tile row and first tile column of the table.
        self.frame = np.array([0, -4, -4], dtype=np.int64)
        self._box = np.zeros(4, dtype=np.int64)
        self._allocate(64)
        self._settings = np.array([cell_size_m, 0.0, 3.0])

    def _allocate(self, tiles: int) -> None:
        self._tiles = tiles
        cells = tiles * _kernels.TILE_CELLS
        self.arrays: tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int8], NDArray[np.int32]] = (
            np.zeros((cells, 5), dtype=np.float32),
            np.zeros(cells, dtype=np.uint8),
            np.zeros(cells, dtype=np.int8),
            np.full(cells, -1, dtype=np.int32),
        )

    def clear(self) -> None:
        """Removes all content and keeps the memory."""
        self.table.fill(-1)
        used = int(self.frame[0]) * _kernels.TILE_CELLS
        self.frame[0] = 0
        self._settings[1] = 0.0
        surface, returns, evidence, nearest = self.arrays
        surface[:used] = 0.0
        returns[:used] = 0
        evidence[:used] = 0
        nearest[:used] = -1

    def _make_room(self, box: NDArray[np.int64]) -> None:
        """Grows the table over the box of tiles, and the arrays by as many tiles as the box may need."""
        rows, columns = self.table.shape
        top, left = int(self.frame[1]), int(self.frame[2])
        bottom, right = top + rows, left + columns
        # A half more on the side that was too small, so that the table does not have to grow often.
        new_top = min(top, int(box[0]) - rows // 2) if box[0] < top else top
        new_left = min(left, int(box[1]) - columns // 2) if box[1] < left else left
        new_bottom = max(bottom, int(box[2]) + 1 + rows // 2) if box[2] >= bottom else bottom
        new_right = max(right, int(box[3]) + 1 + columns // 2) if box[3] >= right else right
        if (new_top, new_left, new_bottom, new_right) != (top, left, bottom, right):
            table = np.full((new_bottom - new_top, new_right - new_left), -1, dtype=np.int32)
            table[top - new_top : bottom - new_top, left - new_left : right - new_left] = self.table
            self.table = table
            self.frame[1:] = (new_top, new_left)
        wanted = int(self.frame[0] + (box[2] - box[0] + 1) * (box[3] - box[1] + 1))
        if wanted > self._tiles:
            old, used = self.arrays, int(self.frame[0]) * _kernels.TILE_CELLS
            self._allocate(max(wanted, self._tiles + self._tiles // 2))
            self.arrays[0][:used] = old[0][:used]
            self.arrays[1][:used] = old[1][:used]
            self.arrays[2][:used] = old[2][:used]
            self.arrays[3][:used] = old[3][:used]

    def insert(self, points: Float, laser_origin: Float, pose: Float) -> None:
        """Adds a scan: ``points`` (n, 5) from `project_scan`, the laser's position on the robot, ``T_grid_robot``."""
        if len(points) == 0:
            return
        if not _kernels.find_room(
            self.table, self.frame, self._tiles, points, laser_origin, pose, self.cell_size_m, self._box
        ):
            self._make_room(self._box)
        _kernels.insert_points(self.table, self.frame, self.arrays, points, laser_origin, pose, self._settings)
        self._settings[1] = (self._settings[1] + 1) % self._settings[2]
