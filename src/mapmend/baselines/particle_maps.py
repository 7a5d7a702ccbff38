"""The maps of all particles, in one pool of tiles that they share until one of them writes: copy on write."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.baselines import _map_kernels
from mapmend.errors import MapmendError
from mapmend.grid._kernels import REACH, TILE, TILE_CELLS

Float = NDArray[np.float64]

FIRST_TILES = 256
# Every n-th beam clears: with a metre or half a radian between scans, all are needed.
CLEARING_STRIDE = 1

MOST_ENTRIES = 1 << 26
"""The limit of all particles' tables: 256 MB, 2 km x 2 km for 30 particles and cells of 5 cm."""

Cells = tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int8], NDArray[np.uint8]]


class ParticleMaps:
    """``tables`` (particles, rows, columns) names every particle's tiles in the pool; see baselines/_map_kernels.py.

    Resampling copies only tables. A particle's tiles are copied when a scan is about to change them and another
    particle still uses them, so that memory follows the differences between the particles' maps.
    """

    def __init__(self, particles: int, cell_size_m: float) -> None:
        self.cell_size_m = cell_size_m
        self.tables = np.full((particles, 8, 8), -1, dtype=np.int32)
        self.frame = np.array([0, -4, -4], dtype=np.int64)
        self.cells: Cells = _new_cells(FIRST_TILES)
        self._references = np.zeros(FIRST_TILES, dtype=np.int32)
        self._free = np.zeros(FIRST_TILES + 1, dtype=np.int64)
        self._note_free()

    @property
    def tiles_in_use(self) -> int:
        return len(self._references) - int(self._free[-1])

    def claim(self, points: Float, laser: Float, poses: Float) -> Float:
        """Makes all tiles private that a scan at each particle's pose (n, 3) will change; returns `insert`'s settings.

        It runs in one thread, because the order in which tiles are handed out decides their numbers.
        """
        settings = np.array([self.cell_size_m, 0.0, CLEARING_STRIDE, laser[0], laser[1]])
        farthest = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0)) + float(np.hypot(laser[0], laser[1]))
        self._make_room(poses[:, :2].min(axis=0) - farthest, poses[:, :2].max(axis=0) + farthest)
        while not _map_kernels.claim_tiles(
            self.tables, self.frame, (self._references, self._free), self.cells, points, poses, settings
        ):
            self._enlarge()
        return settings

    def insert(self, p: int, points: Float, pose: Float, settings: Float) -> None:
        """Adds a scan to particle p's map, into tiles that `claim` made its own, so that threads do not conflict."""
        _map_kernels.insert_scan(self.tables[p], self.frame, self._references, self.cells, points, pose, settings)

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particle p continues with the map of particle ``parents[p]``."""
        self.tables = self.tables[parents]
        used = self.tables[self.tables >= 0]
        self._references[:] = np.bincount(used, minlength=len(self._references))
        self._note_free()

    def _note_free(self) -> None:
        """The stack of unused tiles, the lowest number on top."""
        unused = np.flatnonzero(self._references == 0)[::-1]
        self._free[: len(unused)] = unused
        self._free[-1] = len(unused)

    def _enlarge(self) -> None:
        """Enlarges the pool by a half."""
        old, tiles = self.cells, len(self._references)
        more = tiles + tiles // 2
        self.cells = _new_cells(more)
        used = tiles * TILE_CELLS
        self.cells[0][:used] = old[0]
        self.cells[1][:used] = old[1]
        self.cells[2][:used] = old[2]
        self.cells[3][:used] = old[3]
        self._references = np.concatenate((self._references, np.zeros(more - tiles, dtype=np.int32)))
        self._free = np.zeros(more + 1, dtype=np.int64)
        self._note_free()

    def _make_room(self, low: Float, high: Float) -> None:
        """Grows the tables over a box (metres), with a half more on the side that was too small."""
        span, margin = self.cell_size_m * TILE, self.cell_size_m * (REACH + 1)
        first = np.floor((low[::-1] - margin) / span).astype(np.int64)
        last = np.floor((high[::-1] + margin) / span).astype(np.int64)
        shape = np.array(self.tables.shape[1:])
        begin, end = self.frame[1:].copy(), self.frame[1:] + shape
        new_begin = np.where(first < begin, first - shape // 2, begin)
        new_end = np.where(last >= end, last + 1 + shape // 2, end)
        if np.array_equal(new_begin, begin) and np.array_equal(new_end, end):
            return
        rows, columns = (new_end - new_begin).tolist()
        if rows * columns * len(self.tables) > MOST_ENTRIES:
            raise MapmendError(
                f"the particles' maps would span {columns * span:.0f} m x {rows * span:.0f} m; correct the jumps in "
                "the log's odometry, or take larger cells (grid.cell_size_m)"
            )
        tables = np.full((len(self.tables), rows, columns), -1, dtype=np.int32)
        top, left = (begin - new_begin).tolist()
        tables[:, top : top + shape[0], left : left + shape[1]] = self.tables
        self.tables = tables
        self.frame[1:] = new_begin


def _new_cells(tiles: int) -> Cells:
    """Memory that is not touched: tiles that are not used yet take none."""
    cells = tiles * TILE_CELLS
    return (
        np.zeros((cells, 5), dtype=np.float32),
        np.zeros(cells, dtype=np.uint8),
        np.zeros(cells, dtype=np.int8),
        np.zeros(cells, dtype=np.uint8),
    )
