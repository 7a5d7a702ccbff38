"""The grid that scans are matched on: cells that know the surface seen in them, in tiles, growing with the building."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmend.grid import _kernels

Float = NDArray[np.float64]


class SurfaceGrid:
    """Cells of ``cell_size_m``, each with the mean place and normal of the returns in it and with the beams' passes.

    Tiles of 32 x 32 cells are taken into use where beams went; memory follows the area that was seen. Every cell also
    knows the nearest surface within three cells: the look-up that matching needs.
    """

    def __init__(self, cell_size_m: float = 0.05) -> None:
        self.cell_size_m = cell_size_m
        self.table = np.full((8, 8), -1, dtype=np.int32)
        # Tiles in use, first tile row and first tile column of the table.
        self.frame = np.array([0, -4, -4], dtype=np.int64)
        self._allocate(64)
        self._settings = np.array([cell_size_m, 0.0, 3.0])

    def _allocate(self, tiles: int) -> None:
        cells = tiles * _kernels.TILE_CELLS
        self.arrays = (
            np.zeros((cells, 4), dtype=np.float32),
            np.zeros((cells, 2), dtype=np.int32),
            np.full(cells, -1, dtype=np.int32),
        )

    def clear(self) -> None:
        """Forgets everything, keeps the memory."""
        self.table.fill(-1)
        used = int(self.frame[0]) * _kernels.TILE_CELLS
        self.frame[0] = 0
        surface, counts, nearest = self.arrays
        surface[:used], counts[:used], nearest[:used] = 0.0, 0, -1

    def _make_room(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Grows the table over the box and the arrays by as many tiles as the box could ask for."""
        tile_m = self.cell_size_m * _kernels.TILE
        margin = self.cell_size_m * (_kernels.REACH + 1)
        first_column, first_row = (math.floor((v - margin) / tile_m) for v in low)
        last_column, last_row = (math.floor((v + margin) / tile_m) for v in high)
        rows, columns = self.table.shape
        row0, column0 = int(self.frame[1]), int(self.frame[2])
        if first_row < row0 or first_column < column0 or last_row >= row0 + rows or last_column >= column0 + columns:
            # Half again as much on the side that was too small: growing costs little in the long run.
            pad_rows, pad_columns = rows // 2 + 1, columns // 2 + 1
            top = min(first_row - pad_rows, row0) if first_row < row0 else row0
            left = min(first_column - pad_columns, column0) if first_column < column0 else column0
            bottom = max(last_row + 1 + pad_rows, row0 + rows) if last_row >= row0 + rows else row0 + rows
            right = last_column + 1 + pad_columns if last_column >= column0 + columns else column0 + columns
            table = np.full((bottom - top, right - left), -1, dtype=np.int32)
            table[row0 - top : row0 - top + rows, column0 - left : column0 - left + columns] = self.table
            self.table = table
            self.frame[1:] = (top, left)
            row0, column0 = top, left
        part = self.table[first_row - row0 : last_row - row0 + 1, first_column - column0 : last_column - column0 + 1]
        wanted = int(self.frame[0]) + int(np.count_nonzero(part < 0))
        have = len(self.arrays[2]) // _kernels.TILE_CELLS
        if wanted > have:
            old = self.arrays
            used = int(self.frame[0]) * _kernels.TILE_CELLS
            self._allocate(max(wanted, 2 * have))
            for new, before in zip(self.arrays, old, strict=True):
                new[:used] = before[:used]

    def insert(self, points: Float, laser_origin: Float, pose: Float) -> None:
        """Adds a scan: ``points`` (n, 4) from `project`, the laser's place on the robot, ``T_grid_robot``."""
        if len(points) == 0:
            return
        reach = float(np.sqrt((points[:, :2] ** 2).sum(axis=1).max()))
        low = (pose[0] - reach, pose[1] - reach)
        high = (pose[0] + reach, pose[1] + reach)
        self._make_room(low, high)
        _kernels.insert_points(self.table, self.frame, self.arrays, points, laser_origin, pose, self._settings)
        self._settings[1] = (self._settings[1] + 1) % self._settings[2]
