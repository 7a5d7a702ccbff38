"""The plain twin of grid/likelihood.py: the likelihood of one place at a time, from the grid's contents."""

import math

from tests.reference.surface_grid import nearest_distance


def likelihood(means, row, column, cell_size_m, std_m):
    """0 to 255 for a field cell, twice as wide as the grid's: the best of its four, each from its centre."""
    best = 0
    for r in (2 * row, 2 * row + 1):
        for c in (2 * column, 2 * column + 1):
            d = nearest_distance(means, (r, c), cell_size_m)
            best = max(best, round(255.0 * math.exp(-(d**2) / (2.0 * std_m**2))))
    return best
