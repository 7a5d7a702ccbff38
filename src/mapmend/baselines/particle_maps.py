"""The maps of all particles, in one pool of tiles that they share until one of them writes: copy on write."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.baselines import _map_kernels
from mapmend.baselines._map_kernels import SharedTiles
from mapmend.errors import MapmendError
from mapmend.grid._kernels import REACH, TILE, TILE_CELLS, Clearing, Tiles, insert_points

Float = NDArray[np.float64]

FIRST_TILES = 256
# Every n-th beam clears: with a metre or half a radian between scans, all are needed.
CLEARING_STRIDE = 1

MOST_ENTRIES = 1 << 26
"""The limit of all particles' tables: 256 MB, 2 km x 2 km for 30 particles and cells of 5 cm."""


class ParticleMaps:
    """``shared.tables`` (particles, rows, columns) names every particle's tiles in the pool; see `SharedTiles`.

    Resampling copies only tables. A particle's tiles are copied when a scan is about to change them and another
    particle still uses them, so that memory follows the differences between the particles' maps.
    """

    def __init__(self, particles: int, cell_size_m: float) -> None:
        self.cell_size_m = float(cell_size_m)
        tables = np.full((particles, 8, 8), -1, dtype=np.int32)
        self.shared = self._new_tiles(tables, np.array([0, -4, -4], dtype=np.int64), FIRST_TILES)
        self._clearing = Clearing(0, CLEARING_STRIDE)
        self._note_free()

    def _new_tiles(self, tables: NDArray[np.int32], frame: NDArray[np.int64], tiles: int) -> SharedTiles:
        """Untouched memory for this many tiles: unused tiles take none."""
        cells = tiles * TILE_CELLS
        return SharedTiles(
            tables,
            frame,
            surface=np.zeros((cells, 5), dtype=np.float32),
            returns=np.zeros(cells, dtype=np.uint8),
            evidence=np.zeros(cells, dtype=np.int8),
            nearest=np.zeros(cells, dtype=np.uint8),
            references=np.zeros(tiles, dtype=np.int32),
            free=np.zeros(tiles + 1, dtype=np.int64),
            cell_size_m=self.cell_size_m,
        )

    def of(self, p: int) -> Tiles:
        """The map of particle p, for kernels; valid until the next `claim` or `resample`."""
        all_maps = self.shared
        return Tiles(
            all_maps.tables[p],
            all_maps.frame,
            all_maps.surface,
            all_maps.returns,
            all_maps.evidence,
            all_maps.nearest,
            all_maps.references,
            self.cell_size_m,
        )

    @property
    def tiles_in_use(self) -> int:
        return len(self.shared.references) - int(self.shared.free[-1])

    def claim(self, points: Float, laser: Float, poses: Float) -> None:
        """Makes all tiles private that a scan at each particle's pose (n, 3) will change; ``laser``: on the robot.

        It runs in one thread, because the order in which tiles are handed out decides their numbers.
        """
        farthest = float(np.hypot(points[:, 0], points[:, 1]).max(initial=0.0)) + float(np.hypot(laser[0], laser[1]))
        self._make_room(poses[:, :2].min(axis=0) - farthest, poses[:, :2].max(axis=0) + farthest)
        while not _map_kernels.claim_tiles(self.shared, points, laser, poses, self._clearing):
            self._enlarge()

    def insert(self, p: int, points: Float, laser: Float, pose: Float) -> None:
        """Adds a scan to particle p's map, into tiles that `claim` made its own, so that threads do not conflict."""
        insert_points(self.of(p), points, laser, pose, self._clearing)

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Particle p continues with the map of particle ``parents[p]``."""
        tables, references = self.shared.tables[parents], self.shared.references
        self.shared = self.shared._replace(tables=tables)
        references[:] = np.bincount(tables[tables >= 0], minlength=len(references))
        self._note_free()

    def _note_free(self) -> None:
        """The stack of unused tiles, the lowest number on top."""
        unused = np.flatnonzero(self.shared.references == 0)[::-1]
        self.shared.free[: len(unused)] = unused
        self.shared.free[-1] = len(unused)

    def _enlarge(self) -> None:
        """Enlarges the pool by a half."""
        old = self.shared
        tiles = len(old.references)
        self.shared = new = self._new_tiles(old.tables, old.frame, tiles + tiles // 2)
        used = tiles * TILE_CELLS
        new.surface[:used] = old.surface
        new.returns[:used] = old.returns
        new.evidence[:used] = old.evidence
        new.nearest[:used] = old.nearest
        new.references[:tiles] = old.references
        self._note_free()

    def _make_room(self, low: Float, high: Float) -> None:
        """Grows the tables over a box (metres), with a half more on the side that was too small."""
        span, margin = self.cell_size_m * TILE, self.cell_size_m * (REACH + 1)
        first = np.floor((low[::-1] - margin) / span).astype(np.int64)
        last = np.floor((high[::-1] + margin) / span).astype(np.int64)
        shape = np.array(self.shared.tables.shape[1:])
        begin, end = self.shared.frame[1:].copy(), self.shared.frame[1:] + shape
        new_begin = np.where(first < begin, first - shape // 2, begin)
        new_end = np.where(last >= end, last + 1 + shape // 2, end)
        if np.array_equal(new_begin, begin) and np.array_equal(new_end, end):
            return
        rows, columns = (new_end - new_begin).tolist()
        if rows * columns * len(self.shared.tables) > MOST_ENTRIES:
            raise MapmendError(
                f"the particles' maps would span {columns * span:.0f} m x {rows * span:.0f} m; correct the jumps in "
                "the log's odometry, or take larger cells (grid.cell_size_m)"
            )
        tables = np.full((len(self.shared.tables), rows, columns), -1, dtype=np.int32)
        top, left = (begin - new_begin).tolist()
        tables[:, top : top + shape[0], left : left + shape[1]] = self.shared.tables
        self.shared = self.shared._replace(tables=tables)
        self.shared.frame[1:] = new_begin
