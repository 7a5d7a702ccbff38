"""Kernels of iterative graph optimization: arrays in, arrays out. Their plain twins are in tests/reference."""

from __future__ import annotations

import math

from mapmend.grid._kernels import cell_at
from mapmend.kernel_cache import kernel
from mapmend.matching._kernels import CLUTTER_WEIGHT, COHERENT, ONE_SIDED, OTHER_SIDE


@kernel
def _fit_of(table, frame, arrays, point, pose, settings):
    """How well a point fits at a pose: 1 on a surface, falling to 0 at the reach (Tukey's biweight).

    The distance is that along the surface's normal, if it has one: along a bare wall the point may be anywhere.
    """
    surface, _, _, nearest = arrays
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + cos * point[0] - sin * point[1]
    y = pose[1] + sin * point[0] + cos * point[1]
    cell = cell_at(table, frame, int(math.floor(y / settings[0])), int(math.floor(x / settings[0])))
    if cell < 0 or nearest[cell] < 0:
        return 0.0
    source = nearest[cell]
    dx, dy = x - surface[source, 0], y - surface[source, 1]
    away = (dx * dx + dy * dy) / (settings[1] * settings[1])
    gx, gy = surface[source, 2], surface[source, 3]
    coherence = gx * gx + gy * gy
    if away > 1.0:
        return 0.0
    if coherence > COHERENT:
        sx = cos * point[2] - sin * point[3]
        sy = sin * point[2] + cos * point[3]
        if surface[source, 4] > ONE_SIDED and sx * gx + sy * gy < OTHER_SIDE:
            return 0.0
        away = (gx * dx + gy * dy) ** 2 / (coherence * settings[1] * settings[1])
    return (1.0 - away) ** 2


@kernel
def compare_fits(table, frame, arrays, points, first, second, settings, result):
    """The mean gain in fit of points (n, 5) on a grid at the ``first`` pose (3,) over the ``second``.

    ``settings`` = (cell size, reach m). ``result``: written: the mean of the points' differences, its standard
    deviation by their scatter, and the mean fit at the first pose; zeros for no points.
    """
    n = max(points.shape[0], 1)
    total, squares, fits = 0.0, 0.0, 0.0
    for k in range(points.shape[0]):
        fit = _fit_of(table, frame, arrays, points[k], first, settings)
        gain = fit - _fit_of(table, frame, arrays, points[k], second, settings)
        fits += fit
        total += gain
        squares += gain * gain
    mean = total / n
    result[0] = mean
    result[1] = math.sqrt(max(squares / n - mean * mean, 0.0) / n)
    result[2] = fits / n


@kernel
def shared_normals(table, frame, arrays, points, pose, axis, settings, result):
    """How much information scan and grid both have along an axis; the noise of their normals is independent.

    The sum over matched points of ``w (s . a)(g . a)``: s is the point's own normal, g that of its surface, a the
    ``axis`` (2,) in the grid's frame, w the weight of the point in matching. Its mean does not contain the noise of the
    normals, while that of ``(g . a)^2`` does. ``settings`` = (cell size, reach of a match m, distance m at which a
    point counts half). ``result``: written: the sum, and the sum of the squares of its terms.
    """
    surface, _, _, nearest = arrays
    size, reach, half = settings[0], settings[1], settings[2]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    total, squares = 0.0, 0.0
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        cell = cell_at(table, frame, int(math.floor(y / size)), int(math.floor(x / size)))
        if cell < 0 or nearest[cell] < 0:
            continue
        source = nearest[cell]
        dx, dy = x - surface[source, 0], y - surface[source, 1]
        if dx * dx + dy * dy > reach * reach:
            continue
        gx, gy = surface[source, 2], surface[source, 3]
        coherence = gx * gx + gy * gy
        sx = cos * points[k, 2] - sin * points[k, 3]
        sy = sin * points[k, 2] + cos * points[k, 3]
        if coherence > COHERENT:
            if surface[source, 4] > ONE_SIDED and sx * gx + sy * gy < OTHER_SIDE:
                continue
            length = math.sqrt(coherence)
            e = (gx * dx + gy * dy) / length
            term = (sx * axis[0] + sy * axis[1]) * (gx * axis[0] + gy * axis[1]) / length
            term /= 1.0 + e * e / (half * half)
        elif points[k, 4] > 0.0:
            term = CLUTTER_WEIGHT / (1.0 + (dx * dx + dy * dy) / (half * half))
        else:
            continue
        total += term
        squares += term * term
    result[0], result[1] = total, squares
