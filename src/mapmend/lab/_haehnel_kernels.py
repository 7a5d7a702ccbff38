"""Kernels of the rival measure: a scan's end points over another scan's occupancy grid."""

from __future__ import annotations

import math

import numpy as np

from mapmend.kernel_cache import kernel

UNKNOWN, FREE, OCCUPIED = 0, 1, 2


@kernel
def draw_grid(reaches, rays, ends, cell_m, half, grid):
    """Draws one scan into ``grid``, (2 half, 2 half), the laser at the corner between its four middle cells.

    ``reaches``: (count,), how far its beams are free; ``rays``: (count, 2), their directions; ``ends``: (k, 2), its
    end points. Beams free the cells of their samples, half a cell apart; end points occupy theirs.
    """
    grid[:] = UNKNOWN
    for k in range(reaches.shape[0]):
        for step in range(int(reaches[k] / (0.5 * cell_m))):
            way = step * 0.5 * cell_m
            column = int(math.floor(way * rays[k, 0] / cell_m)) + half
            row = int(math.floor(way * rays[k, 1] / cell_m)) + half
            if 0 <= row < 2 * half and 0 <= column < 2 * half:
                grid[row, column] = FREE
    for k in range(ends.shape[0]):
        column, row = int(math.floor(ends[k, 0] / cell_m)) + half, int(math.floor(ends[k, 1] / cell_m)) + half
        if 0 <= row < 2 * half and 0 <= column < 2 * half:
            grid[row, column] = OCCUPIED


@kernel
def count_over_grids(pairs, polygons, points, lasers, beams, grid_size, counts):
    """For pairs (k, 2), sorted by the first scan: how many end points of the second lie on cells that the first one's
    grid calls free, and how many on cells it calls occupied: ``counts`` (k, 2). ``grid_size`` = (cell m, half width).
    """
    corners, starts, ends, end_starts = polygons.corners, polygons.offsets, points.xy, points.offsets
    cell_m, half = grid_size[0], int(grid_size[1])
    grid = np.zeros((2 * half, 2 * half), np.uint8)
    drawn = -1
    for p in range(pairs.shape[0]):
        i, j = pairs[p, 0], pairs[p, 1]
        if i != drawn:
            laser = beams.laser_of[i]
            mine = corners[:2, starts[i] : starts[i] + beams.counts[laser]]
            reaches = np.hypot(mine[0], mine[1])
            draw_grid(reaches, beams.rays[laser], ends[end_starts[i] : end_starts[i + 1]], cell_m, half, grid)
            drawn = i
        dx, dy = lasers[j, 0] - lasers[i, 0], lasers[j, 1] - lasers[i, 1]
        ci, si, cj, sj = lasers[i, 2], lasers[i, 3], lasers[j, 2], lasers[j, 3]
        tx, ty = ci * dx + si * dy, -si * dx + ci * dy
        c, s = ci * cj + si * sj, ci * sj - si * cj
        for k in range(end_starts[j], end_starts[j + 1]):
            x, y = tx + c * ends[k, 0] - s * ends[k, 1], ty + s * ends[k, 0] + c * ends[k, 1]
            column, row = int(math.floor(x / cell_m)) + half, int(math.floor(y / cell_m)) + half
            if 0 <= row < 2 * half and 0 <= column < 2 * half:
                if grid[row, column] == FREE:
                    counts[p, 0] += 1
                elif grid[row, column] == OCCUPIED:
                    counts[p, 1] += 1
