"""Kernels of grids of surfaces: arrays in, arrays out. Their plain twins are in tests/reference.

A grid is a table of tiles (`Tiles`). A grid that belongs to one map alone takes tiles into use where it writes. The
maps of a particle filter share tiles (`references`): a kernel writes only to tiles that one particle alone uses, and
the filter gives the particle such tiles before, wherever a scan reaches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

TILE_BITS = 5
TILE = 1 << TILE_BITS
TILE_MASK = TILE - 1
TILE_CELLS = TILE * TILE
REACH = 4
ACROSS = 2 * REACH + 1
# Beyond this many returns, the mean of a cell forgets the oldest, so that a map can follow a door that moved.
MEAN_MEMORY = 40
# A return weighs as much as this many passes: a beam that grazes a wall passes through some of its cells.
RETURN_WEIGHT = 3
# A beam clears up to this many cells from its surface, measured along the surface's normal.
CLEARANCE = 1.5
# Evidence saturates: an object that stood for an hour disappears after this many beams passed through.
MOST_EVIDENCE = 100


class Tiles(NamedTuple):
    """What kernels read and write of a grid.

    ``table[row, column]`` (int32) names a tile of TILE x TILE cells, or -1; ``frame`` (3,) int64: tiles in use, the
    table's first tile row, its first tile column. The other arrays are flat over tiles: a cell's number is
    ``tile * TILE**2 + row_in_tile * TILE + column_in_tile``.

    ``surface[cell]``: mean x, mean y, mean normal x, mean normal y, side of the returns in the cell (float32, metres in
    the grid's frame). The normals point to the sensor that saw the surface first; the side is 1 where all other beams
    came from this side too, lower where a thin wall was seen from both sides. ``returns[cell]``: how many returns the
    mean is of (uint8, saturating: the mean forgets slowly). ``evidence[cell]``: 0 where never seen, above it occupied,
    below it free (int8). ``nearest[cell]``: which occupied cell's mean is nearest to this cell's centre, within REACH
    cells: its number or -1 (int32).

    ``references`` is None for a grid of its own. Where maps share tiles, ``references[tile]`` (int32) counts them, and
    ``nearest`` (uint8) is 0 for none or names the occupied cell by the step to it, in rows and columns: a number would
    be wrong after that cell's tile is copied.
    """

    table: NDArray[np.int32]
    frame: NDArray[np.int64]
    surface: NDArray[np.float32]
    returns: NDArray[np.uint8]
    evidence: NDArray[np.int8]
    nearest: NDArray[np.int32] | NDArray[np.uint8]
    references: NDArray[np.int32] | None
    cell_size_m: float


class Clearing(NamedTuple):
    """Which of a scan's points clear the space up to them: every ``stride``-th from ``first`` on."""

    first: int
    stride: int


class Room(NamedTuple):
    """The box of tiles that a scan needs; whether the table covers it and enough tiles are left."""

    first_row: int
    first_column: int
    last_row: int
    last_column: int
    is_there: bool


@kernel
def cell_at(table, frame, row, column):
    """The number of a cell, or -1 where there is no tile."""
    row -= frame[1] * TILE
    column -= frame[2] * TILE
    if row < 0 or column < 0:
        return -1
    tile_row, tile_column = row >> TILE_BITS, column >> TILE_BITS
    if tile_row >= table.shape[0] or tile_column >= table.shape[1]:
        return -1
    tile = table[tile_row, tile_column]
    if tile < 0:
        return -1
    return tile * TILE_CELLS + (row & TILE_MASK) * TILE + (column & TILE_MASK)


@kernel
def nearest_surface(table, frame, nearest, references, cell, row, column):
    """The number of the occupied cell whose mean lies nearest to a cell, or -1."""
    if references is None:
        return np.int64(nearest[cell])
    step = np.int64(nearest[cell])
    if step == 0:
        return -1
    step -= 1
    return cell_at(table, frame, row + step // ACROSS - REACH, column + step % ACROSS - REACH)


@kernel
def nearest_surfaces(tiles, cells, rows, columns):
    """`nearest_surface` of cells (n,) in ``rows`` and ``columns`` (n,)."""
    found = np.empty(len(cells), np.int64)
    for k in range(len(cells)):
        found[k] = nearest_surface(
            tiles.table, tiles.frame, tiles.nearest, tiles.references, cells[k], rows[k], columns[k]
        )
    return found


@kernel
def nearest_to(table, frame, nearest, references, size, x, y):
    """The number of the cell whose surface is nearest to the cell that a place (m) lies in, or -1.

    ``table``, ``frame``, ``nearest``, ``references``: of the `Tiles`. A kernel
    that takes them out of the tuple within its loop is slower by a quarter: Numba counts the references each time.
    """
    row, column = int(math.floor(y / size)), int(math.floor(x / size))
    cell = cell_at(table, frame, row, column)
    if cell < 0:
        return cell
    return nearest_surface(table, frame, nearest, references, cell, row, column)


@kernel
def _name(references, cell, rows, columns):
    """The entry of ``nearest`` for an occupied cell at an offset of ``rows`` and ``columns``."""
    if references is None:
        return cell
    return (rows + REACH) * ACROSS + (columns + REACH) + 1


@kernel
def _no_name(references):
    """The entry of ``nearest`` where no occupied cell is within reach."""
    if references is None:
        return -1
    return 0


@kernel
def _is_own(references, cell):
    """Whether a cell may be written to: always, or, where tiles are shared, where the map alone uses its tile."""
    if references is None:
        return True
    return references[cell // TILE_CELLS] == 1


@kernel
def _new_tile(table, frame, references, tile_row, tile_column):
    """Takes a tile into use where the table has none; -1 where tiles are shared: the map's own are taken before."""
    if references is None:
        tile = frame[0]
        frame[0] += 1
        table[tile_row, tile_column] = tile
        return tile
    return -1


@kernel
def _new_cell(table, frame, references, row, column):
    """The number of a cell where no tile was, or -1: outside the table, or where tiles are shared."""
    tile_row, tile_column = (row >> TILE_BITS) - frame[1], (column >> TILE_BITS) - frame[2]
    if not (0 <= tile_row < table.shape[0] and 0 <= tile_column < table.shape[1]):
        return -1
    tile = _new_tile(table, frame, references, tile_row, tile_column)
    if tile < 0:
        return -1
    return tile * TILE_CELLS + (row & TILE_MASK) * TILE + (column & TILE_MASK)


@kernel
def _announce(tiles, cell, row, column):
    """After a cell became occupied: cells around it whose nearest surface is farther now point to this cell."""
    table, frame, surface, nearest, references = (
        tiles.table,
        tiles.frame,
        tiles.surface,
        tiles.nearest,
        tiles.references,
    )
    size = tiles.cell_size_m
    mx, my = surface[cell, 0], surface[cell, 1]
    for r in range(row - REACH, row + REACH + 1):
        for c in range(column - REACH, column + REACH + 1):
            other = cell_at(table, frame, r, c)
            if other < 0:
                other = _new_cell(table, frame, references, r, c)
            if other < 0 or not _is_own(references, other):
                continue
            cx, cy = (c + 0.5) * size, (r + 0.5) * size
            old = nearest_surface(table, frame, nearest, references, other, r, c)
            if old >= 0:
                ox, oy = surface[old, 0] - cx, surface[old, 1] - cy
                if ox * ox + oy * oy <= (mx - cx) ** 2 + (my - cy) ** 2:
                    continue
            nearest[other] = _name(references, cell, row - r, column - c)


@kernel
def _withdraw(tiles, cell, row, column):
    """After a cell became free: cells around it that pointed to it look for the next nearest surface."""
    table, frame, surface, nearest, references = (
        tiles.table,
        tiles.frame,
        tiles.surface,
        tiles.nearest,
        tiles.references,
    )
    size, returns = tiles.cell_size_m, tiles.returns
    returns[cell] = 0
    for r in range(row - REACH, row + REACH + 1):
        for c in range(column - REACH, column + REACH + 1):
            other = cell_at(table, frame, r, c)
            if other < 0 or nearest[other] != _name(references, cell, row - r, column - c):
                continue
            if not _is_own(references, other):
                continue
            best, best_d = _no_name(references), 1e18
            cx, cy = (c + 0.5) * size, (r + 0.5) * size
            for rr in range(r - REACH, r + REACH + 1):
                for cc in range(c - REACH, c + REACH + 1):
                    candidate = cell_at(table, frame, rr, cc)
                    if candidate < 0 or returns[candidate] == 0:
                        continue
                    d = (surface[candidate, 0] - cx) ** 2 + (surface[candidate, 1] - cy) ** 2
                    if d < best_d:
                        best, best_d = _name(references, candidate, rr - r, cc - c), d
            nearest[other] = best


@kernel
def _pass_through(tiles, x0, y0, x1, y1, freed, count):
    """Adds one count of free evidence to every cell from (x0, y0) to (x1, y1); writes newly free cells into ``freed``.

    One cell for each step along the longer axis: a beam through the corner of a cell may miss it, but the next one will
    not. Returns the number of freed cells; they stay in the grid until `_withdraw`, so that this loop stays small.
    """
    table, frame, evidence, references = tiles.table, tiles.frame, tiles.evidence, tiles.references
    size = tiles.cell_size_m
    first_row, first_column = frame[1] * TILE, frame[2] * TILE
    x, y = x0 / size - first_column, y0 / size - first_row
    dx, dy = (x1 - x0) / size, (y1 - y0) / size
    length = max(abs(dx), abs(dy))
    if length < 1.0:
        return count
    step_x, step_y = dx / length, dy / length
    tile_row, tile_column, tile = -1, -1, np.int64(-1)
    for _ in range(int(length)):
        row, column = int(y), int(x)
        if row >> TILE_BITS != tile_row or column >> TILE_BITS != tile_column:
            tile_row, tile_column = row >> TILE_BITS, column >> TILE_BITS
            tile = np.int64(table[tile_row, tile_column])
            if tile < 0:
                tile = _new_tile(table, frame, references, tile_row, tile_column)
            if tile >= 0 and not _is_own(references, tile * TILE_CELLS):
                tile = np.int64(-1)
        if tile >= 0:
            cell = tile * TILE_CELLS + (row & TILE_MASK) * TILE + (column & TILE_MASK)
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
def clear_share(dx, dy, nx, ny, size):
    """The share of a beam (dx, dy) to a surface with this normal that clears cells; it clears none if the share is
    below 0.

    A beam that grazes a surface runs close to it for a long way and must not clear the surface's own cells there.
    """
    length = math.sqrt(dx * dx + dy * dy)
    steepness = abs(nx * dx + ny * dy) / (length + 1e-9)
    return 1.0 - CLEARANCE * size / (max(steepness, 0.1) * length + 1e-9)


@kernel
def average(surface, returns, cell, x, y, nx, ny):
    """Adds a return to a cell that already has some."""
    if returns[cell] < MEAN_MEMORY:
        returns[cell] += 1
    share = 1.0 / returns[cell]
    surface[cell, 0] += share * (x - surface[cell, 0])
    surface[cell, 1] += share * (y - surface[cell, 1])
    if nx == 0.0 and ny == 0.0:
        return  # the point has no normal: the direction of the surface stays as it is
    if surface[cell, 2] == 0.0 and surface[cell, 3] == 0.0:
        surface[cell, 2], surface[cell, 3] = nx, ny
        return
    seen_from = 1.0
    if nx * surface[cell, 2] + ny * surface[cell, 3] < 0.0:
        seen_from, nx, ny = -1.0, -nx, -ny
    surface[cell, 2] += share * (nx - surface[cell, 2])
    surface[cell, 3] += share * (ny - surface[cell, 3])
    surface[cell, 4] += share * (seen_from - surface[cell, 4])


@kernel
def find_room(tiles, points, origin, pose):
    """The `Room` that a scan's points and its laser need. ``origin``: the laser's position on the robot."""
    table, frame, size = tiles.table, tiles.frame, tiles.cell_size_m
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    low_x = high_x = pose[0] + cos * origin[0] - sin * origin[1]
    low_y = high_y = pose[1] + sin * origin[0] + cos * origin[1]
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    span, margin = size * TILE, size * (REACH + 1)
    top, left = int(math.floor((low_y - margin) / span)), int(math.floor((low_x - margin) / span))
    bottom, right = int(math.floor((high_y + margin) / span)), int(math.floor((high_x + margin) / span))
    is_covered = top >= frame[1] and left >= frame[2]
    is_covered = is_covered and bottom < frame[1] + table.shape[0] and right < frame[2] + table.shape[1]
    tiles_left = tiles.returns.shape[0] // TILE_CELLS - frame[0]
    return Room(top, left, bottom, right, is_covered and (bottom - top + 1) * (right - left + 1) <= tiles_left)


@kernel
def insert_points(tiles, points, origin, pose, clearing):
    """Inserts one scan's points (n, 5), robot frame, into a grid at ``pose`` (grid frame, metres from the corner).

    ``origin`` = the laser's position on the robot; ``clearing``: a `Clearing`. The caller ensures that enough tiles are
    left, or, where they are shared, that the map alone uses the tiles that the scan reaches.
    """
    table, frame, references, size = tiles.table, tiles.frame, tiles.references, tiles.cell_size_m
    surface, returns, evidence = tiles.surface, tiles.returns, tiles.evidence
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ox = pose[0] + cos * origin[0] - sin * origin[1]
    oy = pose[1] + sin * origin[0] + cos * origin[1]
    freed = np.empty((256, 3), np.int64)
    count = 0
    for k in range(clearing.first, points.shape[0], clearing.stride):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        dx, dy = x - ox, y - oy
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        clear = clear_share(dx, dy, nx, ny, size)
        if clear > 0.0:
            count = _pass_through(tiles, ox, oy, ox + clear * dx, oy + clear * dy, freed, count)
    for k in range(count):
        _withdraw(tiles, freed[k, 0], freed[k, 1], freed[k, 2])
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        row, column = int(math.floor(y / size)), int(math.floor(x / size))
        cell = cell_at(table, frame, row, column)
        if cell < 0:
            cell = _new_cell(table, frame, references, row, column)
        if cell < 0 or not _is_own(references, cell):
            continue
        evidence[cell] = min(max(evidence[cell], 0) + RETURN_WEIGHT, MOST_EVIDENCE)
        if returns[cell] == 0:
            returns[cell] = 1
            surface[cell, 0], surface[cell, 1] = x, y
            surface[cell, 2], surface[cell, 3], surface[cell, 4] = nx, ny, 1.0
            _announce(tiles, cell, row, column)
        else:
            average(surface, returns, cell, x, y, nx, ny)
