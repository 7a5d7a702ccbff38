"""The map that is written: for every cell, how many beams returned from it and how many passed through.

Every node's scan is put at its optimized pose, so the map shows the graph and no earlier estimate of the front end.
Beams without return are not counted: glass and black walls look to the laser like open space.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import GridConfig, ScanConfig
from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose
from mapmend.grid._kernel_types import MapFrame
from mapmend.maps import FREE, FREE_THRESHOLD, OCCUPIED, UNKNOWN, OccupancyMap
from mapmend.parallel import Progress, map_in_order, no_progress
from mapmend.scan import Scans

Float = NDArray[np.float64]

FREE_SHARE = FREE_THRESHOLD
"""A cell is free below this share, which is nav2's limit; in between it stays unknown."""

MOST_CELLS = 1 << 28
"""A map of more cells than this (0.8 km x 0.8 km of 5 cm) is not a building but a lost trajectory."""

BAND_ROWS = 128
_BEAMS_AT_ONCE = 1 << 16


@dataclass(frozen=True)
class _Beams:
    """Scans with their lasers' poses in the map, as the kernel needs them."""

    scans: Scans
    directions: Float
    lasers: Float
    shortest_m: float
    longest_m: float


def occupancy_map(
    scans: Scans,
    poses: Float,
    config: ScanConfig,
    grid: GridConfig,
    *,
    threads: int = 1,
    progress: Progress = no_progress,
) -> OccupancyMap:
    """The map of n scans taken at ``poses``, shape (n, 3), ``T_map_robot``: 254 free, 0 occupied, 205 unknown.

    Cells are aligned to the map frame's origin. Readings beyond ``config.max_range_m`` clear up to there
    and mark nothing. The rows are counted in bands, one thread for each band, with whole numbers in each cell: the same
    bytes for any number of threads, and no memory except one byte for each cell and the counts of some bands.
    Raises MapmendError for other shapes, poses that are not finite, and extents that no building has.
    """
    if poses.shape != (len(scans), 3):
        raise MapmendError(f"a map of {len(scans)} scans needs poses of shape ({len(scans)}, 3), got {poses.shape}")
    if not np.all(np.isfinite(poses)):
        raise MapmendError("a map needs finite poses")
    beams = _place(scans, poses, config)
    cell_size_m = grid.cell_size_m
    first_cell, shape = _extent(beams, cell_size_m)
    image = np.full(shape, UNKNOWN, dtype=np.uint8)
    origin = (first_cell[0] * cell_size_m, first_cell[1] * cell_size_m, 0.0)
    corner_and_limits = (origin[0], origin[1], cell_size_m, beams.shortest_m, beams.longest_m)
    frame = MapFrame(*(float(value) for value in corner_and_limits))

    def fill(first_row: int) -> None:
        band = image[first_row : first_row + BAND_ROWS]
        _judge(_count(beams, frame, first_row, band.shape), grid.occupied_share, band)

    map_in_order(fill, range(0, shape[0], BAND_ROWS), threads, "map", progress)
    return OccupancyMap(image, cell_size_m, origin)


def _place(scans: Scans, poses: Float, config: ScanConfig) -> _Beams:
    most = max((g.beam_count for g in scans.geometries), default=0)
    directions = np.zeros((max(len(scans.geometries), 1), most, 2))
    mountings = np.zeros((max(len(scans.geometries), 1), 3))
    for k, geometry in enumerate(scans.geometries):
        bearings = geometry.bearings_rad()
        directions[k, : len(bearings)] = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
        mountings[k] = geometry.T_robot_laser
    laser = compose(poses, mountings[scans.geometry_index])
    lasers = np.column_stack((laser[:, :2], np.cos(laser[:, 2]), np.sin(laser[:, 2])))
    return _Beams(scans, directions, lasers, config.min_range_m, config.max_range_m)


def _extent(beams: _Beams, cell_size_m: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Column and row of the lowest cell, from the map frame's origin, and (rows, columns) that hold all beams."""
    places = np.array([p for ends in _ends(beams) for p in (ends.min(axis=0), ends.max(axis=0))])
    if not len(places):
        places = np.zeros((1, 2))
    low, high = places.min(axis=0), places.max(axis=0)
    width_m, height_m = (high - low).tolist()
    # One more cell on each side, for a beam that ends on the edge.
    columns, rows = (math.ceil(length / cell_size_m) + 3 for length in (width_m, height_m))
    if rows * columns > MOST_CELLS or max(rows, columns) > MOST_CELLS:
        raise MapmendError(
            f"the map would span {width_m:.0f} m x {height_m:.0f} m, {rows * columns:.2g} cells of {cell_size_m:g} m; "
            "correct the jumps in the log's odometry, or take larger cells (grid.cell_size_m)"
        )
    return (math.floor(low[0] / cell_size_m) - 1, math.floor(low[1] / cell_size_m) - 1), (rows, columns)


def _ends(beams: _Beams) -> Iterator[Float]:
    """Where lasers stood and where their beams ended, (k, 2) at a time, metres in the map."""
    scans = beams.scans
    if len(scans):
        yield beams.lasers[:, :2]
    step = max(1, _BEAMS_AT_ONCE // max(beams.directions.shape[1], 1))
    for first in range(0, len(scans), step):
        counts = np.diff(scans.offsets[first : first + step + 1])
        row = first + np.repeat(np.arange(len(counts)), counts)
        ranges = scans.ranges_m[scans.offsets[first] : scans.offsets[first] + len(row)].astype(np.float64)
        beam = scans.offsets[first] + np.arange(len(row)) - scans.offsets[row]
        used = np.isfinite(ranges) & (ranges >= beams.shortest_m)
        if not used.any():
            continue
        row, length = row[used], np.minimum(ranges[used], beams.longest_m)
        dx, dy = beams.directions[scans.geometry_index[row], beam[used]].T
        x, y, cos, sin = beams.lasers[row].T
        yield np.stack((x + length * (cos * dx - sin * dy), y + length * (sin * dx + cos * dy)), axis=1)


def _count(beams: _Beams, frame: MapFrame, first_row: int, shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Returns and passes of a band of the map, int32, (2, rows, columns)."""
    from mapmend.grid._occupancy_kernels import count_beams

    counts = np.zeros((2, *shape), dtype=np.int32)
    scans = (beams.scans.ranges_m, beams.scans.offsets, beams.scans.geometry_index)
    count_beams(scans, beams.directions, beams.lasers, frame, first_row, counts)
    return counts


def _judge(counts: NDArray[np.int32], occupied_share: float, band: NDArray[np.uint8]) -> None:
    """Writes free, occupied or unknown into ``band``, (rows, columns), from its returns and passes."""
    returns, passes = counts
    seen = returns + passes
    band[(seen > 0) & (returns < FREE_SHARE * seen)] = FREE
    band[(returns > 0) & (returns >= occupied_share * seen)] = OCCUPIED
