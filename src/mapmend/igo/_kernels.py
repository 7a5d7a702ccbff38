"""Kernels of iterative graph optimization: arrays in, arrays out. Their plain twins stand in tests/reference."""

from __future__ import annotations

import math

from numba import njit

from mapmend.grid._kernels import cell_at
from mapmend.matching._kernels import CLUTTER_WEIGHT, COHERENT, ONE_SIDED, OTHER_SIDE


@njit(cache=True, nogil=True)
def shared_normals(table, frame, arrays, points, pose, axis, settings, result):
    """How far scan and grid agree on surfaces that hold a pose along an axis, of whose noise they share nothing.

    The sum over matched points of ``w (s . a)(g . a)``: s is the point's own normal, g that of the surface it lies on,
    a the ``axis`` (2,) in the grid's frame, w the weight of the point in matching. Noise of the normals has no part in
    its mean, as it has in that of ``(g . a)^2``. ``settings`` = (cell size, reach of a match m, distance m at which a
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
