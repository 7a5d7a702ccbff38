"""Kernels of the tuning: which pairs of scans may overlap, and how far a pair's measure may have changed.

``circles``: (n, 3), a circle in the laser's frame that holds all that a scan sees: x, y, radius, which is negative for
a scan that sees nothing. ``lasers``: (f, n, 4), the lasers in each of f maps: x, y, cosine and sine of the heading.
"""

from __future__ import annotations

import math

from mapmend.kernel_cache import kernel


@kernel
def place_circles(lasers, circles, centres):
    """The centres of the circles in each map: ``centres`` (f, n, 2)."""
    for f in range(lasers.shape[0]):
        for i in range(lasers.shape[1]):
            c, s = lasers[f, i, 2], lasers[f, i, 3]
            centres[f, i, 0] = lasers[f, i, 0] + c * circles[i, 0] - s * circles[i, 1]
            centres[f, i, 1] = lasers[f, i, 1] + s * circles[i, 0] + c * circles[i, 1]


@kernel
def sampled_pairs(first, stride, centres, circles, found):
    """The number of pairs (i, j), i < j, among every ``stride``-th, whose circles meet in any of the maps.

    Every ``stride``-th partner of scan i is taken, with another first partner for each scan. ``first`` = (the first i,
    the end). The pairs are written into ``found``: (k, 2), in order, if it is not empty.
    """
    count = 0
    maps, n = centres.shape[0], centres.shape[1]
    for i in range(first[0], first[1]):
        if circles[i, 2] < 0.0:
            continue
        # The stride is a power of two: multiples of an odd number reach all its remainders evenly.
        for j in range(i + 1 + (i * 40503) % stride, n, stride):
            if circles[j, 2] < 0.0:
                continue
            reach = circles[i, 2] + circles[j, 2]
            for f in range(maps):
                dx, dy = centres[f, j, 0] - centres[f, i, 0], centres[f, j, 1] - centres[f, i, 1]
                if dx * dx + dy * dy <= reach * reach:
                    if found.shape[0] > 0:
                        found[count, 0], found[count, 1] = i, j
                    count += 1
                    break
    return count


@kernel
def change_bounds(pairs, lasers, sums, kept, now, bounds):
    """By how much, at most, M_ij of each pair (k, 2) differs from what it was at ``kept``: ``bounds`` (k,), metres.

    The depth of a point in a polygon, MC (1), changes by no more than the point moves. Scan j's points p move in scan
    i's frame by ``|(R' - R) p + t' - t|``, which is at most ``rho |p| + |t' - t|`` with rho the chord of the turn; the
    other way round likewise, with the inverse. ``lasers``: (n, 4). ``sums``: (n, 2), the number of a scan's end points
    and the sum of their distances from the laser. ``kept`` and ``now``: (k, 4), T_i_j as x, y, cosine, sine; ``now``
    is filled. A pair without a pose in ``kept`` (nan) has no bound: infinity.
    """
    for row in range(pairs.shape[0]):
        i, j = pairs[row, 0], pairs[row, 1]
        dx, dy = lasers[j, 0] - lasers[i, 0], lasers[j, 1] - lasers[i, 1]
        ci, si, cj, sj = lasers[i, 2], lasers[i, 3], lasers[j, 2], lasers[j, 3]
        x, y = ci * dx + si * dy, -si * dx + ci * dy
        c, s = ci * cj + si * sj, ci * sj - si * cj
        now[row, 0], now[row, 1], now[row, 2], now[row, 3] = x, y, c, s
        x0, y0, c0, s0 = kept[row, 0], kept[row, 1], kept[row, 2], kept[row, 3]
        if math.isnan(x0):
            bounds[row] = math.inf
            continue
        chord = math.hypot(c - c0, s - s0)
        shift = math.hypot(x - x0, y - y0)
        # The inverse's translation is -R^T t.
        back = math.hypot(c * x + s * y - c0 * x0 - s0 * y0, c * y - s * x - c0 * y0 + s0 * x0)
        bounds[row] = chord * (sums[i, 1] + sums[j, 1]) + sums[j, 0] * shift + sums[i, 0] * back
