"""Kernels of the particles' maps: arrays in, arrays out. Their plain twins are in tests/reference.

All particles' maps are in one pool of tiles of TILE x TILE cells, the cells of the surface grid (grid/_kernels.py).
``tables[p, row, column]`` names the tile of particle p, or -1; ``frame`` = (unused, first tile row, first tile column).
Particles share a tile until one of them writes to it: ``references[tile]`` counts them, and ``free`` is a stack of
unused tiles, its height in ``free[-1]``. ``cells`` = (surface, returns, evidence, nearest) as in the surface
grid, but ``nearest`` (uint8) is 0 for none or names the occupied cell by its offset in rows and columns: a cell
number would be wrong after that cell's tile is copied.
"""

from __future__ import annotations

import math

import numpy as np

from mapmend.grid._kernels import (
    MOST_EVIDENCE,
    REACH,
    RETURN_WEIGHT,
    TILE,
    TILE_BITS,
    TILE_CELLS,
    TILE_MASK,
    average,
    cell_at,
    clear_share,
)
from mapmend.kernel_cache import kernel

ACROSS = 2 * REACH + 1
# Beams are followed in steps of this many cells to find the tiles that they touch. If a step cuts the corner of a tile,
# nothing is written there.
STRIDE_CELLS = 8


@kernel
def _own(tables, p, row, column, pool, cells):
    """Ensures that the tile at a position of particle p's table is its own; False if no tile is left."""
    references, free = pool
    old = tables[p, row, column]
    if old >= 0 and references[old] == 1:
        return True
    if free[-1] == 0:
        return False
    free[-1] -= 1
    new = free[free[-1]]
    surface, returns, evidence, nearest = cells
    first, end = new * TILE_CELLS, (new + 1) * TILE_CELLS
    if old < 0:
        surface[first:end] = 0.0
        returns[first:end] = 0
        evidence[first:end] = 0
        nearest[first:end] = 0
    else:
        source, last = old * TILE_CELLS, (old + 1) * TILE_CELLS
        surface[first:end] = surface[source:last]
        returns[first:end] = returns[source:last]
        evidence[first:end] = evidence[source:last]
        nearest[first:end] = nearest[source:last]
        references[old] -= 1
    references[new] = 1
    tables[p, row, column] = new
    return True


@kernel
def claim_tiles(tables, frame, pool, cells, points, poses, settings):
    """Gives every particle the tiles that a scan at its pose will write to; False if the pool is too small.

    ``settings`` = (cell size, first beam and stride of those that clear, x and y of the laser on the robot). Claimed
    tiles stay claimed: after a False, enlarge the pool and call again.
    """
    size, margin = settings[0], settings[0] * (REACH + 1)
    span = size * TILE
    for p in range(poses.shape[0]):
        cos, sin = math.cos(poses[p, 2]), math.sin(poses[p, 2])
        ox = poses[p, 0] + cos * settings[3] - sin * settings[4]
        oy = poses[p, 1] + sin * settings[3] + cos * settings[4]
        for k in range(points.shape[0]):
            x = poses[p, 0] + cos * points[k, 0] - sin * points[k, 1]
            y = poses[p, 1] + sin * points[k, 0] + cos * points[k, 1]
            low_r, high_r = int(math.floor((y - margin) / span)), int(math.floor((y + margin) / span))
            low_c, high_c = int(math.floor((x - margin) / span)), int(math.floor((x + margin) / span))
            for r in range(low_r, high_r + 1):
                for c in range(low_c, high_c + 1):
                    if not _own(tables, p, r - frame[1], c - frame[2], pool, cells):
                        return False
            if (k - int(settings[1])) % int(settings[2]) != 0:
                continue
            steps = int(math.hypot(x - ox, y - oy) / (size * STRIDE_CELLS)) + 1
            for s in range(steps):
                row = int(math.floor((oy + (y - oy) * s / steps) / span)) - frame[1]
                column = int(math.floor((ox + (x - ox) * s / steps) / span)) - frame[2]
                if not _own(tables, p, row, column, pool, cells):
                    return False
    return True


@kernel
def _own_cell(table, frame, references, row, column):
    """The number of a cell in a tile that this particle alone uses, or -1."""
    cell = cell_at(table, frame, row, column)
    if cell < 0 or references[cell // TILE_CELLS] != 1:
        return -1
    return cell


@kernel
def nearest_surface(table, frame, nearest, cell, row, column):
    """The number of the occupied cell nearest to a cell, or -1."""
    code = int(nearest[cell])
    if code == 0:
        return -1
    code -= 1
    return cell_at(table, frame, row + code // ACROSS - REACH, column + code % ACROSS - REACH)


@kernel
def _announce(table, frame, references, cells, cell, row, column, size):
    """After a cell became occupied: cells around it whose nearest surface is farther now point to this cell."""
    surface, _, _, nearest = cells
    mx, my = surface[cell, 0], surface[cell, 1]
    for r in range(row - REACH, row + REACH + 1):
        for c in range(column - REACH, column + REACH + 1):
            other = _own_cell(table, frame, references, r, c)
            if other < 0:
                continue
            cx, cy = (c + 0.5) * size, (r + 0.5) * size
            old = nearest_surface(table, frame, nearest, other, r, c)
            if old >= 0:
                dx, dy = surface[old, 0] - cx, surface[old, 1] - cy
                if dx * dx + dy * dy <= (mx - cx) ** 2 + (my - cy) ** 2:
                    continue
            nearest[other] = (row - r + REACH) * ACROSS + (column - c + REACH) + 1


@kernel
def _withdraw(table, frame, references, cells, cell, row, column, size):
    """After a cell became free: cells around it that pointed to it look for the next nearest surface."""
    surface, returns, _, nearest = cells
    returns[cell] = 0
    for r in range(row - REACH, row + REACH + 1):
        for c in range(column - REACH, column + REACH + 1):
            other = _own_cell(table, frame, references, r, c)
            if other < 0 or nearest[other] != (row - r + REACH) * ACROSS + (column - c + REACH) + 1:
                continue
            best, best_d = 0, 1e18
            cx, cy = (c + 0.5) * size, (r + 0.5) * size
            for rr in range(r - REACH, r + REACH + 1):
                for cc in range(c - REACH, c + REACH + 1):
                    candidate = cell_at(table, frame, rr, cc)
                    if candidate < 0 or returns[candidate] == 0:
                        continue
                    d = (surface[candidate, 0] - cx) ** 2 + (surface[candidate, 1] - cy) ** 2
                    if d < best_d:
                        best, best_d = (rr - r + REACH) * ACROSS + (cc - c + REACH) + 1, d
            nearest[other] = best


@kernel
def _pass_through(table, frame, references, evidence, ray, size, freed, count):
    """Adds one count of free evidence to every cell of ``ray`` (x0, y0, x1, y1); writes newly free cells into
    ``freed``.

    One cell for each step along the longer axis. Returns the number of freed cells; they stay until `_withdraw`.
    """
    first_row, first_column = frame[1] * TILE, frame[2] * TILE
    x, y = ray[0] / size - first_column, ray[1] / size - first_row
    dx, dy = (ray[2] - ray[0]) / size, (ray[3] - ray[1]) / size
    length = max(abs(dx), abs(dy))
    if length < 1.0:
        return count
    step_x, step_y = dx / length, dy / length
    tile_row, tile_column, base = -1, -1, -1
    for _ in range(int(length)):
        row, column = int(y), int(x)
        if row >> TILE_BITS != tile_row or column >> TILE_BITS != tile_column:
            tile_row, tile_column = row >> TILE_BITS, column >> TILE_BITS
            tile = table[tile_row, tile_column]
            base = tile * TILE_CELLS if tile >= 0 and references[tile] == 1 else -1
        if base >= 0:
            cell = base + (row & TILE_MASK) * TILE + (column & TILE_MASK)
            if evidence[cell] > -MOST_EVIDENCE:
                evidence[cell] -= 1
                if evidence[cell] == 0:
                    if count < freed.shape[0]:
                        evidence[cell] = -1
                        freed[count, 0], freed[count, 1], freed[count, 2] = cell, row + first_row, column + first_column
                        count += 1
                    else:
                        evidence[cell] = 1  # ``freed`` is full: the next beam through this cell frees it
        x += step_x
        y += step_y
    return count


@kernel
def insert_scan(table, frame, references, cells, points, pose, settings):
    """Inserts one scan's points (n, 5), robot frame, into one particle's map at ``pose``; its tiles were claimed
    before.

    ``settings`` as in `claim_tiles`. The rules are those of the surface grid (`insert_points` in grid/_kernels.py).
    """
    surface, returns, evidence, _ = cells
    size = settings[0]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ox = pose[0] + cos * settings[3] - sin * settings[4]
    oy = pose[1] + sin * settings[3] + cos * settings[4]
    freed = np.empty((256, 3), np.int64)
    ray = np.empty(4)
    count = 0
    for k in range(int(settings[1]), points.shape[0], int(settings[2])):
        dx = pose[0] + cos * points[k, 0] - sin * points[k, 1] - ox
        dy = pose[1] + sin * points[k, 0] + cos * points[k, 1] - oy
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        clear = clear_share(dx, dy, nx, ny, size)
        if clear > 0.0:
            ray[0], ray[1], ray[2], ray[3] = ox, oy, ox + clear * dx, oy + clear * dy
            count = _pass_through(table, frame, references, evidence, ray, size, freed, count)
    for k in range(count):
        _withdraw(table, frame, references, cells, freed[k, 0], freed[k, 1], freed[k, 2], size)
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        row, column = int(math.floor(y / size)), int(math.floor(x / size))
        cell = _own_cell(table, frame, references, row, column)
        if cell < 0:
            continue
        evidence[cell] = min(max(evidence[cell], 0) + RETURN_WEIGHT, MOST_EVIDENCE)
        if returns[cell] == 0:
            returns[cell] = 1
            surface[cell, 0], surface[cell, 1] = x, y
            surface[cell, 2], surface[cell, 3], surface[cell, 4] = nx, ny, 1.0
            _announce(table, frame, references, cells, cell, row, column, size)
        else:
            average(surface, returns, cell, x, y, nx, ny)
