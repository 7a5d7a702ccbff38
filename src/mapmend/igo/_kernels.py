"""Kernels of iterative graph optimization: arrays in, arrays out. Their plain twins are in tests/reference."""

from __future__ import annotations

import math
from typing import NamedTuple

from mapmend.grid._kernels import nearest_to
from mapmend.kernel_cache import kernel
from mapmend.matching._surface_kernels import constraint, is_from_behind, squared_distance


class FitDifference(NamedTuple):
    """The mean gain in fit of points at one pose over another, its noise, and the mean fit at the first pose.

    The noise is the standard deviation of the mean gain, by the points' scatter. Zeros for no points.
    """

    gain: float
    noise: float
    fit: float


class SharedNormals(NamedTuple):
    """The sum of `shared_normals` over a scan's points, and the sum of the squares of its terms."""

    total: float
    squares: float


@kernel
def _fit_of(mx, my, side, dx, dy, nx, ny, reach2):
    """How well a point fits a surface: 1 on it, falling to 0 at the reach (Tukey's biweight).

    The distance is that along the surface's normal, if it has one: along a bare wall the point may be anywhere. If it
    has none, every point counts, thin or not: a fit does not constrain a pose, it only says how near points end.
    (mx, my), ``side``: the surface's mean normal and side; (dx, dy), (nx, ny): the point's offset from the surface's
    mean, and its normal.
    """
    if dx * dx + dy * dy > reach2 or is_from_behind(mx, my, side, nx, ny):
        return 0.0
    return (1.0 - squared_distance(mx, my, dx, dy) / reach2) ** 2


@kernel
def compare_fits(tiles, points, first, second, reach_m):
    """The `FitDifference` of points (n, 5) on a grid between the poses ``first`` and ``second``, (3,) each."""
    table, frame, surface, nearest = tiles.table, tiles.frame, tiles.surface, tiles.nearest
    references, size = tiles.references, tiles.cell_size_m
    n = max(points.shape[0], 1)
    cosines, sines = (math.cos(first[2]), math.cos(second[2])), (math.sin(first[2]), math.sin(second[2]))
    total, squares, fits = 0.0, 0.0, 0.0
    for k in range(points.shape[0]):
        fit, gain = 0.0, 0.0
        for other in range(2):
            pose, cos, sin = second if other else first, cosines[other], sines[other]
            x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
            y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
            source = nearest_to(table, frame, nearest, references, size, x, y)
            if source < 0:
                continue
            dx, dy = x - surface[source, 0], y - surface[source, 1]
            nx = cos * points[k, 2] - sin * points[k, 3]
            ny = sin * points[k, 2] + cos * points[k, 3]
            value = _fit_of(
                surface[source, 2], surface[source, 3], surface[source, 4], dx, dy, nx, ny, reach_m * reach_m
            )
            if other:
                gain -= value
            else:
                fit = gain = value
        fits += fit
        total += gain
        squares += gain * gain
    mean = total / n
    return FitDifference(mean, math.sqrt(max(squares / n - mean * mean, 0.0) / n), fits / n)


@kernel
def shared_normals(tiles, points, pose, axis, reach_m, half_weight_m):
    """How much information scan and grid both have along an axis; the noise of their normals is independent.

    The sum over matched points (n, 5) of ``w (s . a)(g . a)``: s is the point's own normal, g that of its surface, a
    the ``axis`` (2,) in the grid's frame, w the weight of the point in matching. Its mean does not contain the noise of
    the normals, while that of ``(g . a)^2`` does. ``half_weight_m``: the distance at which a point counts half.
    """
    table, frame, surface, nearest = tiles.table, tiles.frame, tiles.surface, tiles.nearest
    references, size = tiles.references, tiles.cell_size_m
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    total, squares = 0.0, 0.0
    for k in range(points.shape[0]):
        x = pose[0] + cos * points[k, 0] - sin * points[k, 1]
        y = pose[1] + sin * points[k, 0] + cos * points[k, 1]
        source = nearest_to(table, frame, nearest, references, size, x, y)
        if source < 0:
            continue
        dx, dy = x - surface[source, 0], y - surface[source, 1]
        mx, my = surface[source, 2], surface[source, 3]
        sx = cos * points[k, 2] - sin * points[k, 3]
        sy = sin * points[k, 2] + cos * points[k, 3]
        if dx * dx + dy * dy > reach_m * reach_m or is_from_behind(mx, my, surface[source, 4], sx, sy):
            continue
        is_flat, gx, gy, term = constraint(mx, my, dx, dy, points[k, 4] > 0.0, half_weight_m * half_weight_m)
        if is_flat:
            term *= (sx * axis[0] + sy * axis[1]) * (gx * axis[0] + gy * axis[1])
        total += term
        squares += term * term
    return SharedNormals(total, squares)
