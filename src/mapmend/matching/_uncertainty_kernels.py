"""Kernels of the covariance of a match: arrays in, arrays out. Their plain twins stand in tests/reference."""

from __future__ import annotations

import math

import numpy as np

from mapmend.grid._kernels import nearest_to
from mapmend.kernel_cache import kernel
from mapmend.matching._surface_kernels import constraint, is_from_behind

# Successive points lie on one surface unless the next one is farther away than this, or the surfaces' normals differ by
# more than some 30 degrees. A longer surface counts as several: other poses drew what lies a metre on.
MOST_STEP_M = 0.3
SAME_NORMAL = 0.85
SURFACE_M = 1.0
# The positions in `result` of the sums that `sum_surfaces` writes.
NORMAL, SHARED = 0, 6
WITHIN, FREEDOM, BETWEEN, EXPECTED, WEIGHT, SURFACES, RETURNS, COUNT = range(12, 20)
SUMS = 20
# The positions in `surface` of the sums over the points of one surface: weights, their squares, weighted distances and
# squared distances, weighted Jacobian, points, and first and last point.
_W, _W2, _WE, _WEE, _JX, _JY, _JT, _N, _X0, _Y0, _X, _Y = range(12)


@kernel
def _close(surface, size, result):
    """Adds the sums of a surface to those of the scan, and empties it."""
    if surface[_N] > 0.0:
        w = surface[_W]
        jx, jy, jt = surface[_JX], surface[_JY], surface[_JT]
        result[SHARED] += jx * jx
        result[SHARED + 1] += jx * jy
        result[SHARED + 2] += jx * jt
        result[SHARED + 3] += jy * jy
        result[SHARED + 4] += jy * jt
        result[SHARED + 5] += jt * jt
        result[WITHIN] += surface[_WEE] - surface[_WE] * surface[_WE] / w
        result[FREEDOM] += w - surface[_W2] / w
        result[BETWEEN] += surface[_WE] * surface[_WE] / w
        result[EXPECTED] += surface[_W2] / w
        result[WEIGHT] += w
        result[SURFACES] += 1.0
        if surface[_N] > 1.0:
            dx, dy = surface[_X] - surface[_X0], surface[_Y] - surface[_Y0]
            length = max(math.sqrt(dx * dx + dy * dy), size)
            result[RETURNS] += surface[_N] * (surface[_N] - 1.0) * size / length
            result[COUNT] += surface[_N]
    surface[:] = 0.0


@kernel
def _add(surface, nx, ny, jt, e, w, result):
    """Adds a distance with its weight and Jacobian (nx, ny, jt) to a surface and to the normal matrix."""
    result[NORMAL] += w * nx * nx
    result[NORMAL + 1] += w * nx * ny
    result[NORMAL + 2] += w * nx * jt
    result[NORMAL + 3] += w * ny * ny
    result[NORMAL + 4] += w * ny * jt
    result[NORMAL + 5] += w * jt * jt
    surface[_W] += w
    surface[_W2] += w * w
    surface[_WE] += w * e
    surface[_WEE] += w * e * e
    surface[_JX] += w * nx
    surface[_JY] += w * ny
    surface[_JT] += w * jt
    surface[_N] += 1.0


@kernel
def sum_surfaces(tiles, points, pose, reach, half, deviations, result):
    """The sums over the surfaces of a scan that its covariance is made of; returns the number of ``deviations``.

    A surface is a run of successive points on cells with like normals. ``reach``: of a match (m). ``half``: the
    distance (m) at which a point counts half. ``deviations`` (n,): written: how far points lie off the middle of their
    two neighbours on the same surface, along its normal. ``result`` (SUMS,): written: the normal matrix (xx, xy, xt,
    yy, yt, tt); the same of the surfaces' summed Jacobians; the squared distances within the surfaces and their degrees
    of freedom; those of the surfaces' means, what these are per unit of variance, the sum of weights, and the number of
    surfaces; the returns that one scan leaves in a cell, summed over points, and the number of these.
    """
    table, frame, cells, nearest = tiles.table, tiles.frame, tiles.surface, tiles.nearest
    references, size = tiles.references, tiles.cell_size_m
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    result[:] = 0.0
    surface = np.zeros(12)
    # The two points before: row, place, normal.
    row1, row2 = -9, -9
    x1, y1, nx1, ny1 = 0.0, 0.0, 0.0, 0.0
    x2, y2, nx2, ny2 = 0.0, 0.0, 0.0, 0.0
    found = 0
    for k in range(points.shape[0]):
        rx = cos * points[k, 0] - sin * points[k, 1]
        ry = sin * points[k, 0] + cos * points[k, 1]
        x, y = pose[0] + rx, pose[1] + ry
        source = nearest_to(table, frame, nearest, references, size, x, y)
        if source < 0:
            continue
        dx, dy = x - cells[source, 0], y - cells[source, 1]
        mx, my = cells[source, 2], cells[source, 3]
        sx = cos * points[k, 2] - sin * points[k, 3]
        sy = sin * points[k, 2] + cos * points[k, 3]
        if dx * dx + dy * dy > reach * reach or is_from_behind(mx, my, cells[source, 4], sx, sy):
            continue
        is_flat, nx, ny, w = constraint(mx, my, dx, dy, points[k, 4] > 0.0, half * half)
        if not is_flat:
            if w > 0.0:
                _close(surface, size, result)
                _add(surface, 1.0, 0.0, -ry, dx, w, result)
                _close(surface, size, result)
                _add(surface, 0.0, 1.0, rx, dy, w, result)
                _close(surface, size, result)
            continue
        if surface[_N] > 0.0:
            step = (x - surface[_X]) ** 2 + (y - surface[_Y]) ** 2
            begun = (x - surface[_X0]) ** 2 + (y - surface[_Y0]) ** 2
            if step > MOST_STEP_M**2 or begun > SURFACE_M**2 or nx * nx1 + ny * ny1 < SAME_NORMAL:
                _close(surface, size, result)
        if surface[_N] == 0.0:
            surface[_X0], surface[_Y0] = x, y
        surface[_X], surface[_Y] = x, y
        _add(surface, nx, ny, -nx * ry + ny * rx, nx * dx + ny * dy, w, result)
        is_between = row1 == k - 1 and row2 == k - 2
        if is_between and nx * nx1 + ny * ny1 > SAME_NORMAL and nx2 * nx1 + ny2 * ny1 > SAME_NORMAL:
            deviations[found] = abs(nx1 * (x1 - 0.5 * (x + x2)) + ny1 * (y1 - 0.5 * (y + y2)))
            found += 1
        row2, x2, y2, nx2, ny2 = row1, x1, y1, nx1, ny1
        row1, x1, y1, nx1, ny1 = k, x, y, nx, ny
    _close(surface, size, result)
    return found


@kernel
def core_variance(deviations, most):
    """The mean square of deviations (n,) that are at most so many standard deviations, as their median tells; n > 0."""
    limit = most * 1.4826 * np.median(deviations)
    total, count = 0.0, 0
    for k in range(deviations.shape[0]):
        if deviations[k] <= limit:
            total += deviations[k] * deviations[k]
            count += 1
    return total / count
