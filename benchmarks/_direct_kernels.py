"""MC (1) and (2) as printed, O(K^2), compiled: the library's measure is timed against this."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def place(xy, pose, placed):
    """Points (k, 2) seen from the map, at a pose (x, y, cosine, sine)."""
    for k in range(xy.shape[0]):
        placed[k, 0] = pose[0] + pose[2] * xy[k, 0] - pose[3] * xy[k, 1]
        placed[k, 1] = pose[1] + pose[3] * xy[k, 0] + pose[2] * xy[k, 1]


@njit(cache=True, nogil=True)
def sum_depths(points, polygon):
    """How many points lie inside, by the sides that a line to the right crosses, and the sum of their distances."""
    count, total, corners = 0, 0.0, polygon.shape[0]
    for k in range(points.shape[0]):
        x, y = points[k, 0], points[k, 1]
        inside, last = False, corners - 1
        for corner in range(corners):
            x0, y0, x1, y1 = polygon[last, 0], polygon[last, 1], polygon[corner, 0], polygon[corner, 1]
            if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
                inside = not inside
            last = corner
        if not inside:
            continue
        nearest, last = np.inf, corners - 1
        for corner in range(corners):
            x0, y0 = polygon[last, 0], polygon[last, 1]
            ex, ey = polygon[corner, 0] - x0, polygon[corner, 1] - y0
            dx, dy = x - x0, y - y0
            length2 = ex * ex + ey * ey
            share = min(max((dx * ex + dy * ey) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
            dx, dy = dx - share * ex, dy - share * ey
            nearest = min(nearest, dx * dx + dy * dy)
            last = corner
        count += 1
        total += math.sqrt(nearest)
    return count, total


@njit(cache=True, nogil=True)
def measure_directly(pairs, corners, corner_offsets, points, point_offsets, lasers, measured):
    """n_ij and M_ij, (k, 2), of pairs (k, 2): corners and end points of all scans end to end, in the lasers' frames."""
    for row in range(pairs.shape[0]):
        measured[row] = 0.0
        for side in range(2):
            i, j = pairs[row, side], pairs[row, 1 - side]
            polygon = np.empty((corner_offsets[i + 1] - corner_offsets[i], 2))
            place(corners[corner_offsets[i] : corner_offsets[i + 1]], lasers[i], polygon)
            others = np.empty((point_offsets[j + 1] - point_offsets[j], 2))
            place(points[point_offsets[j] : point_offsets[j + 1]], lasers[j], others)
            n, total = sum_depths(others, polygon)
            measured[row, 0] += n
            measured[row, 1] += total
