"""The rule by which a scan's points and the surfaces of a grid belong together, and Gauss-Newton's sums over them.

Matching, judging, fits, shared normals and the likelihood of the particle filter all use these functions. What they do
differently is in the caller.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mapmend.grid._kernels import nearest_to
from mapmend.kernel_cache import kernel

# A mean normal at least this long (squared) belongs to one flat surface; shorter ones to corners and clutter.
COHERENT = 0.6
# A post constrains the pose in every direction, but with the discrete mean of a cell, so it counts less. Other points
# on cells without a direction do not count: the far end of the visible part of a wall moves with the robot.
CLUTTER_WEIGHT = 0.3
# Cosine between the normals of a point and of a surface below which they are two sides of a thin wall.
OTHER_SIDE = -0.3
# A surface whose side is at least this was seen from one side only: a point that sees it from behind is another wall.
ONE_SIDED = 0.8


class NormalEquations(NamedTuple):
    """Gauss-Newton's sums over a scan's points at a pose.

    ``xx`` to ``tt``: the normal matrix; ``bx``, ``by``, ``bt``: the gradient, half of it; ``matched``: how many points
    lie within the counted distance of their surface; ``weights``, ``squares``: the sums of the points' weights and of
    their weighted squared distances.
    """

    xx: float
    xy: float
    xt: float
    yy: float
    yt: float
    tt: float
    bx: float
    by: float
    bt: float
    matched: int
    weights: float
    squares: float


@kernel
def wrap(angle):
    """The angle in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def is_from_behind(mx, my, side, nx, ny):
    """Whether a point with the normal (nx, ny) sees a surface from behind: then it belongs to another surface.

    (mx, my), ``side``: the surface's mean normal and side.
    """
    return mx * mx + my * my > COHERENT and side > ONE_SIDED and nx * mx + ny * my < OTHER_SIDE


@kernel
def direction(mx, my):
    """Whether a surface with that mean normal is flat, and its unit normal; zeros where it is a corner or clutter."""
    coherence = mx * mx + my * my
    if coherence > COHERENT:
        length = math.sqrt(coherence)
        return True, np.float64(mx / length), np.float64(my / length)
    return False, 0.0, 0.0


@kernel
def squared_distance(mx, my, dx, dy):
    """Of a point at (dx, dy) from a surface's mean: along its normal, where it is flat."""
    is_flat, nx, ny = direction(mx, my)
    if is_flat:
        e = nx * dx + ny * dy
        return e * e
    return dx * dx + dy * dy


@kernel
def constraint(mx, my, dx, dy, is_thin, half2):
    """How a point at (dx, dy) from a surface's mean constrains a pose: whether along a normal, this normal, the weight.

    Without a normal, thin points (posts, legs) constrain it in every direction, others in none: their weight is 0. The
    weights are those of Cauchy's loss; ``half2`` is the squared distance at which a point counts half.
    """
    is_flat, nx, ny = direction(mx, my)
    if is_flat:
        e = nx * dx + ny * dy
        return is_flat, nx, ny, 1.0 / (1.0 + e * e / half2)
    if is_thin:
        return is_flat, nx, ny, CLUTTER_WEIGHT / (1.0 + (dx * dx + dy * dy) / half2)
    return is_flat, nx, ny, 0.0


@kernel
def sum_points(tiles, points, x, y, theta, gate2, counted2, half2):
    """The `NormalEquations` of points (n, 5) at a pose.

    Points farther than ``gate2`` (squared) from the mean of their surface are left out; those within ``counted2`` are
    matched.
    """
    table, frame, surface, nearest = tiles.table, tiles.frame, tiles.surface, tiles.nearest
    references, size = tiles.references, tiles.cell_size_m
    cos, sin = math.cos(theta), math.sin(theta)
    hxx, hxy, hxt, hyy, hyt, htt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    bx, by, bt = 0.0, 0.0, 0.0
    matched, weights, squares = 0, 0.0, 0.0
    for k in range(points.shape[0]):
        rx = cos * points[k, 0] - sin * points[k, 1]
        ry = sin * points[k, 0] + cos * points[k, 1]
        qx, qy = x + rx, y + ry
        source = nearest_to(table, frame, nearest, references, size, qx, qy)
        if source < 0:
            continue
        dx, dy = qx - surface[source, 0], qy - surface[source, 1]
        d2 = dx * dx + dy * dy
        if d2 > gate2:
            continue
        mx, my = surface[source, 2], surface[source, 3]
        sx = cos * points[k, 2] - sin * points[k, 3]
        sy = sin * points[k, 2] + cos * points[k, 3]
        if is_from_behind(mx, my, surface[source, 4], sx, sy):
            continue
        if d2 < counted2:
            matched += 1
        is_flat, nx, ny, w = constraint(mx, my, dx, dy, points[k, 4] > 0.0, half2)
        if is_flat:
            e = nx * dx + ny * dy
            j = -nx * ry + ny * rx
            hxx += w * nx * nx
            hxy += w * nx * ny
            hxt += w * nx * j
            hyy += w * ny * ny
            hyt += w * ny * j
            htt += w * j * j
            bx += w * nx * e
            by += w * ny * e
            bt += w * j * e
            weights += w
            squares += w * e * e
        elif w > 0.0:
            hxx += w
            hxt += -w * ry
            hyy += w
            hyt += w * rx
            htt += w * (rx * rx + ry * ry)
            bx += w * dx
            by += w * dy
            bt += w * (-ry * dx + rx * dy)
            weights += w
            squares += w * d2
    return NormalEquations(hxx, hxy, hxt, hyy, hyt, htt, bx, by, bt, matched, weights, squares)


@kernel
def step(sums, prior, s2, x, y, theta):
    """Gauss-Newton's step (x, y, theta) from a pose, and whether there is one.

    ``prior`` (4, 3): its information along the map's axes, and in the last row the expected pose. It is multiplied
    by ``s2``, the variance of a point's distance (m^2).
    """
    px, py, pt = x - prior[3, 0], y - prior[3, 1], wrap(theta - prior[3, 2])
    axx, axy, axt = sums.xx + s2 * prior[0, 0], sums.xy + s2 * prior[0, 1], sums.xt + s2 * prior[0, 2]
    ayy, ayt, att = sums.yy + s2 * prior[1, 1], sums.yt + s2 * prior[1, 2], sums.tt + s2 * prior[2, 2]
    gx = sums.bx + s2 * (prior[0, 0] * px + prior[0, 1] * py + prior[0, 2] * pt)
    gy = sums.by + s2 * (prior[0, 1] * px + prior[1, 1] * py + prior[1, 2] * pt)
    gt = sums.bt + s2 * (prior[0, 2] * px + prior[1, 2] * py + prior[2, 2] * pt)
    # Cramer's rule on the symmetric 3 x 3 system.
    cxx, cxy, cxt = ayy * att - ayt * ayt, axt * ayt - axy * att, axy * ayt - axt * ayy
    determinant = axx * cxx + axy * cxy + axt * cxt
    if not determinant > 1e-30:
        return False, 0.0, 0.0, 0.0
    cyy, cyt, ctt = axx * att - axt * axt, axy * axt - axx * ayt, axx * ayy - axy * axy
    step_x = -(cxx * gx + cxy * gy + cxt * gt) / determinant
    step_y = -(cxy * gx + cyy * gy + cyt * gt) / determinant
    step_t = -(cxt * gx + cyt * gy + ctt * gt) / determinant
    return True, step_x, step_y, step_t
