"""The plain twin of grid/_occupancy_kernels.py: every beam by itself, every cell of it from the definition."""

import math
from fractions import Fraction


def count_beams(scans, poses, config, origin, cell_size_m, shape):
    """Returns and passes, two lists of rows, of all scans at laser poses (x, y, theta)."""
    rows, columns = shape
    returns = [[0] * columns for _ in range(rows)]
    passes = [[0] * columns for _ in range(rows)]
    for k, (x, y, theta) in enumerate(poses):
        for reading, bearing in zip(scans.ranges_of(k).tolist(), scans.geometry_of(k).bearings_rad(), strict=False):
            if not math.isfinite(reading) or reading < config.min_range_m:
                continue
            length = min(reading, config.max_range_m)
            end = (x + length * math.cos(theta + bearing), y + length * math.sin(theta + bearing))
            begin_cell = cell_of((x, y), origin, cell_size_m)
            end_cell = cell_of(end, origin, cell_size_m)
            for row, column in line(begin_cell, end_cell):
                passes[row][column] += 1
            if reading <= config.max_range_m:
                returns[end_cell[0]][end_cell[1]] += 1
    return returns, passes


def cell_of(place, origin, cell_size_m):
    return tuple(math.floor((place[axis] - origin[axis]) / cell_size_m) for axis in (1, 0))


def line(begin, end):
    """The cells from ``begin`` up to, and without, ``end``."""
    steps = max(abs(end[0] - begin[0]), abs(end[1] - begin[1]))
    for k in range(steps):
        shares = [rounded(Fraction(k * abs(b - a), steps)) for a, b in zip(begin, end, strict=True)]
        yield tuple(a + s * (1 if b > a else -1) for a, b, s in zip(begin, end, shares, strict=True))


def rounded(x):
    """To the nearest whole number, halves up."""
    return math.floor(x + Fraction(1, 2))
