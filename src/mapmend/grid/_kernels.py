"""Kernels of the surface grid: arrays in, arrays out. Their plain twins are in tests/reference.

A grid is a table of tiles: ``table[row, column]`` names a tile of TILE x TILE cells, or -1; ``frame`` = (tiles in use,
the table's first tile row, its first tile column). Cell arrays are flat over tiles; a cell's number is
``tile * TILE**2 + row_in_tile * TILE + column_in_tile``. They come as one tuple:
``surface[cell]`` = mean x, mean y, mean normal x, mean normal y, side of the returns in the cell (float32, metres in
the grid's frame). The normals point to the sensor that saw the surface first; the side is 1 where all other beams came
from this side too, lower where a thin wall was seen from both sides;
``returns[cell]`` = how many the mean stands for (uint8, saturating: the mean forgets slowly);
``evidence[cell]`` = 0 where never seen, above it occupied, below it free (int8);
``nearest[cell]`` = the number of the occupied cell whose mean is nearest to this cell's centre, within REACH cells,
or -1 (int32).
"""

from __future__ import annotations

import math

import numpy as np

from mapmend.kernel_cache import kernel

TILE_BITS = 5
TILE = 1 << TILE_BITS
TILE_MASK = TILE - 1
TILE_CELLS = TILE * TILE
REACH = 4
# Beyond this many returns, the mean of a cell forgets the oldest, so that a map can follow a door that moved.
MEAN_MEMORY = 40
# Neighbouring points farther apart than this are never one wall, even if they are on a line.
MOST_CHORD_M = 5.0
# A post or a leg is at most this many times as wide as the least distance of neighbours.
MOST_THIN_BEAMS = 4
# Neighbours are at most this many beams away: 10 degrees of a common dense laser, for things at arm's length.
MOST_AWAY = 40
# A return weighs as much as this many passes: a beam that grazes a wall passes through some of its cells.
RETURN_WEIGHT = 3
# A beam clears up to this many cells from its surface, measured along the surface's normal.
CLEARANCE = 1.5
# Evidence saturates: an object that stood for an hour disappears after this many beams passed through.
MOST_EVIDENCE = 100


@kernel
def project_scan(ranges, cosines, sines, limits, mounting, points):
    """Returns of one scan as points with normals in the robot's frame: rows (x, y, normal x, normal y, thin).

    ``limits`` = (shortest usable range m, longest usable range m, largest difference to a neighbour's range on one
    surface as a share of the range, distance m from the neighbours' chord up to which a point farther from them is
    still on one wall with them, least number of beams to a neighbour, and that number times the range). The normal is
    that of the chord between the two neighbours, towards the laser; (0, 0) if they are on different surfaces.
    The points of a wall seen at a grazing angle are far apart, but on one line. "thin" is 1 for the points of a post or
    a leg, which constrain the pose in every direction, else 0. Returns the number of rows written.
    """
    count = 0
    beams = ranges.shape[0]
    cos_m, sin_m = math.cos(mounting[2]), math.sin(mounting[2])
    for k in range(beams):
        r = float(ranges[k])
        if not (limits[0] <= r <= limits[1]):
            continue
        x, y = r * cosines[k], r * sines[k]
        nx, ny = 0.0, 0.0
        away = max(int(limits[4]), min(int(limits[5] / r), MOST_AWAY))
        if away <= k < beams - away:
            i, j = k - away, k + away
            before, after = float(ranges[i]), float(ranges[j])
            gap = limits[2] * r + limits[3]
            bx, by = before * cosines[i], before * sines[i]
            tx, ty = after * cosines[j] - bx, after * sines[j] - by
            length = math.sqrt(tx * tx + ty * ty)
            if 1e-6 < length < MOST_CHORD_M:
                near = abs(before - r) < gap and abs(after - r) < gap
                # On a straight wall the inverse ranges change evenly; from a jamb to the surface behind it they do not.
                between = (before - r) * (after - r) < 0.0 and abs(2.0 * before * after / (before + after) - r) < gap
                if near or (between and abs(tx * (y - by) - ty * (x - bx)) < limits[3] * length):
                    nx, ny = -ty / length, tx / length
                    if nx * x + ny * y > 0.0:
                        nx, ny = -nx, -ny
        points[count, 0] = mounting[0] + cos_m * x - sin_m * y
        points[count, 1] = mounting[1] + sin_m * x + cos_m * y
        points[count, 2] = cos_m * nx - sin_m * ny
        points[count, 3] = sin_m * nx + cos_m * ny
        points[count, 4] = 1.0 if _is_thin(ranges, k, limits[2] * r + limits[3], int(limits[4])) else 0.0
        count += 1
    return count


@kernel
def _is_thin(ranges, k, gap, away):
    """Whether beam k hits one of a few neighbouring points with only farther things beside them on both sides.

    The last point of a wall before its end, or before the laser's range ends, does not count: it moves with the robot.
    """
    width = 1
    for step in (-1, 1):
        i = k + step
        while 0 <= i < ranges.shape[0] and abs(ranges[i] - ranges[k]) < gap and width <= MOST_THIN_BEAMS * away:
            width += 1
            i += step
        if not (0 <= i < ranges.shape[0] and ranges[i] > ranges[k] + gap):
            return False
    return width <= MOST_THIN_BEAMS * away


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
def _claim(table, frame, row, column):
    """The number of a cell, whose tile is taken into use if necessary; -1 outside the table."""
    row -= frame[1] * TILE
    column -= frame[2] * TILE
    if row < 0 or column < 0:
        return -1
    tile_row, tile_column = row >> TILE_BITS, column >> TILE_BITS
    if tile_row >= table.shape[0] or tile_column >= table.shape[1]:
        return -1
    tile = table[tile_row, tile_column]
    if tile < 0:
        tile = frame[0]
        frame[0] += 1
        table[tile_row, tile_column] = tile
    return tile * TILE_CELLS + (row & TILE_MASK) * TILE + (column & TILE_MASK)


@kernel
def _announce(table, frame, surface, nearest, cell, row, column, size):
    """After a cell became occupied: cells around it whose nearest surface is farther now point to this cell."""
    mx, my = surface[cell, 0], surface[cell, 1]
    for r in range(row - REACH, row + REACH + 1):
        for c in range(column - REACH, column + REACH + 1):
            other = _claim(table, frame, r, c)
            if other < 0:
                continue
            cx, cy = (c + 0.5) * size, (r + 0.5) * size
            old = nearest[other]
            if old >= 0:
                ox, oy = surface[old, 0] - cx, surface[old, 1] - cy
                if ox * ox + oy * oy <= (mx - cx) ** 2 + (my - cy) ** 2:
                    continue
            nearest[other] = cell


@kernel
def _withdraw(table, frame, arrays, cell, row, column, size):
    """After a cell became free: cells around it that pointed to it look for the next nearest surface."""
    surface, returns, _, nearest = arrays
    returns[cell] = 0
    for r in range(row - REACH, row + REACH + 1):
        for c in range(column - REACH, column + REACH + 1):
            other = cell_at(table, frame, r, c)
            if other < 0 or nearest[other] != cell:
                continue
            best, best_d = -1, 1e18
            cx, cy = (c + 0.5) * size, (r + 0.5) * size
            for rr in range(r - REACH, r + REACH + 1):
                for cc in range(c - REACH, c + REACH + 1):
                    candidate = cell_at(table, frame, rr, cc)
                    if candidate < 0 or returns[candidate] == 0:
                        continue
                    d = (surface[candidate, 0] - cx) ** 2 + (surface[candidate, 1] - cy) ** 2
                    if d < best_d:
                        best, best_d = candidate, d
            nearest[other] = best


@kernel
def _pass_through(table, frame, arrays, x0, y0, x1, y1, settings, freed, count):
    """Adds one count of free evidence to every cell from (x0, y0) to (x1, y1); writes newly free cells into ``freed``.

    One cell for each step along the longer axis: a beam through the corner of a cell may miss it, but the next one will
    not. Returns the number of freed cells; they stay in the grid until `_withdraw`, so that this loop stays small.
    """
    evidence, size = arrays[2], settings[0]
    first_row, first_column = frame[1] * TILE, frame[2] * TILE
    x, y = x0 / size - first_column, y0 / size - first_row
    dx, dy = (x1 - x0) / size, (y1 - y0) / size
    length = max(abs(dx), abs(dy))
    if length < 1.0:
        return count
    step_x, step_y = dx / length, dy / length
    for _ in range(int(length)):
        row, column = int(y), int(x)
        tile = table[row >> TILE_BITS, column >> TILE_BITS]
        if tile < 0:
            tile = frame[0]
            frame[0] += 1
            table[row >> TILE_BITS, column >> TILE_BITS] = tile
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
def find_room(table, frame, tiles, points, origin, pose, size, box):
    """Whether the table covers a scan's points and its laser, and enough tiles are left for them.

    ``origin`` = the laser's position on the robot; ``box``: written: first row, first column, last row, last column, in
    tiles, of the area that the scan needs.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    low_x = high_x = pose[0] + cos * origin[0] - sin * origin[1]
    low_y = high_y = pose[1] + sin * origin[0] + cos * origin[1]
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    span, margin = size * TILE, size * (REACH + 1)
    box[0], box[1] = int(math.floor((low_y - margin) / span)), int(math.floor((low_x - margin) / span))
    box[2], box[3] = int(math.floor((high_y + margin) / span)), int(math.floor((high_x + margin) / span))
    if box[0] < frame[1] or box[1] < frame[2]:
        return False
    if box[2] >= frame[1] + table.shape[0] or box[3] >= frame[2] + table.shape[1]:
        return False
    return frame[0] + (box[2] - box[0] + 1) * (box[3] - box[1] + 1) <= tiles


@kernel
def insert_points(table, frame, arrays, points, origin, pose, settings):
    """Inserts one scan's points (robot frame) into the grid at ``pose`` (grid frame, metres from the corner).

    ``origin`` = the laser's position on the robot; ``settings`` = (cell size, first beam and stride of those that
    clear). The caller ensures that enough tiles are left.
    """
    size = settings[0]
    surface, returns, evidence, nearest = arrays
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    ox = pose[0] + cos * origin[0] - sin * origin[1]
    oy = pose[1] + sin * origin[0] + cos * origin[1]
    freed = np.empty((256, 3), np.int64)
    count = 0
    for k in range(int(settings[1]), points.shape[0], int(settings[2])):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        dx, dy = x - ox, y - oy
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        clear = clear_share(dx, dy, nx, ny, size)
        if clear > 0.0:
            count = _pass_through(
                table, frame, arrays, ox, oy, ox + clear * dx, oy + clear * dy, settings, freed, count
            )
    for k in range(count):
        _withdraw(table, frame, arrays, freed[k, 0], freed[k, 1], freed[k, 2], size)
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        nx = cos * points[k, 2] - sin * points[k, 3]
        ny = sin * points[k, 2] + cos * points[k, 3]
        row, column = int(math.floor(y / size)), int(math.floor(x / size))
        cell = _claim(table, frame, row, column)
        if cell < 0:
            continue
        evidence[cell] = min(max(evidence[cell], 0) + RETURN_WEIGHT, MOST_EVIDENCE)
        if returns[cell] == 0:
            returns[cell] = 1
            surface[cell, 0], surface[cell, 1] = x, y
            surface[cell, 2], surface[cell, 3], surface[cell, 4] = nx, ny, 1.0
            _announce(table, frame, surface, nearest, cell, row, column, size)
        else:
            average(surface, returns, cell, x, y, nx, ny)
