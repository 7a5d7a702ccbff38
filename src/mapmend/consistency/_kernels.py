"""Kernels of the pairwise measure, MC (1) and (2). Their plain twins are in tests/reference.

Scans are stored one after the other. All arrays are in the laser's frame unless they say map.

``polygons``, ``points`` and ``beams`` are the named tuples of views.py. ``lasers``: (n, 4), x, y, cosine and sine of
the heading in the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

SECTORS = 1024
"""Of the pseudo-angle over a full turn: they show for half of all points that these are outside, and for the others the
wedge."""

WIDE_SECTORS = 64
"""The same for groups of points."""

GROUP, GROUP_RADIUS_M = 16, 0.4
"""Neighbouring end points are tested together: at most this many, in a circle of this radius."""

WINDOW = 2
"""How many of a polygon's first vertices are repeated after its last one, so that three neighbouring sides are always
contiguous."""

BLOCK = 64
"""How many pairs are compared together."""

ZERO, TWO, FOUR, TINY = np.float32(0.0), np.float32(2.0), np.float32(4.0), np.float32(1e-30)


class Drop(NamedTuple):
    """How many of a pair's largest depths are left out: the least number, and the least share of them."""

    points: int
    share: float


class Room(NamedTuple):
    """The scratch memory for BLOCK pairs.

    Views, two a pair: the scans that look and are looked at (2 BLOCK, 2), the poses of the latter in the frames of the
    former (2 BLOCK, 4), and where the points of each begin (2 BLOCK + 1,). Points: their rows, sectors or wedges,
    positions (2, most), and depths. Of one scan: sectors, squared distances, and flags.
    """

    scans: NDArray[np.int64]
    frames: NDArray[np.float64]
    begins: NDArray[np.int64]
    rows: NDArray[np.int64]
    places: NDArray[np.int64]
    xy: NDArray[np.float64]
    depths: NDArray[np.float64]
    sectors: NDArray[np.int32]
    squares: NDArray[np.float32]
    is_near: NDArray[np.bool_]


@kernel
def sector_of(x, y, sectors):
    """The sector of a bearing: y / (|x| + |y|), which rises with the angle, unrolled to four quarters of a turn."""
    if x == 0.0 and y == 0.0:
        return sectors // 2
    q = y / (abs(x) + abs(y))
    unrolled = math.copysign(2.0, y) - q if x < 0.0 else q
    # By rounding, half a turn may give the end of the last sector.
    return min(int((unrolled + 2.0) * (sectors / 4.0)), sectors - 1)


@kernel(error_model="numpy")
def sectors_of(frame, xy, begin, end, count, sectors, squares):
    """The sectors and squared distances from the laser of the points ``xy`` from ``begin`` to before ``end``.

    ``frame`` = (x, y, cosine, sine) of their laser. Float32 without branches, so that compilers vectorize the loop.
    """
    tx, ty, c, s = frame
    xs, ys = xy[0, begin:end], xy[1, begin:end]
    scale, last = np.float32(count / 4.0), np.int32(count - 1)
    for k in range(end - begin):
        x = tx + c * xs[k] - s * ys[k]
        y = ty + s * xs[k] + c * ys[k]
        q = y / (abs(x) + abs(y) + TINY)
        behind, below = np.float32(x < ZERO), np.float32(y < ZERO)
        unrolled = q + behind * (TWO - FOUR * below - TWO * q)
        sectors[k] = max(min(np.int32((unrolled + TWO) * scale), last), np.int32(0))
        squares[k] = x * x + y * y


@kernel
def room_for(points):
    """The scratch memory for BLOCK pairs, enough for the worst case."""
    of_points, of_groups, most = points.offsets, points.group_offsets, 0
    for row in range(of_points.shape[0] - 1):
        most = max(most, of_points[row + 1] - of_points[row], of_groups[row + 1] - of_groups[row])
    # Collecting without a branch writes one element beyond the last.
    of_all, of_one = 2 * BLOCK * most + 1, most + 1
    return Room(
        np.empty((2 * BLOCK, 2), np.int64),
        np.empty((2 * BLOCK, 4)),
        np.zeros(2 * BLOCK + 1, np.int64),
        np.empty(of_all, np.int64),
        np.empty(of_all, np.int64),
        np.empty((2, of_all)),
        np.empty(of_all),
        np.empty(of_one, np.int32),
        np.empty(of_one, np.float32),
        np.empty(of_one, np.bool_),
    )


@kernel
def look(pairs, stands, lasers, block, room):
    """Prepares both views of each pair in ``block``, rows of ``pairs`` (k, 2); returns their number."""
    scans, frames = room.scans, room.frames
    for n in range(block.shape[0]):
        row = block[n]
        for side in range(2):
            here, there = stands[row, side], stands[row, 1 - side]
            dx, dy = lasers[there, 0] - lasers[here, 0], lasers[there, 1] - lasers[here, 1]
            ci, si, cj, sj = lasers[here, 2], lasers[here, 3], lasers[there, 2], lasers[there, 3]
            view = 2 * n + side
            scans[view, 0], scans[view, 1] = pairs[row, side], pairs[row, 1 - side]
            # The second laser in the frame of the first.
            frames[view, 0], frames[view, 1] = ci * dx + si * dy, -si * dx + ci * dy
            frames[view, 2], frames[view, 3] = ci * cj + si * sj, ci * sj - si * cj
    return 2 * block.shape[0]


@kernel
def find_near(views, polygons, points, room):
    """The end points that may be inside by the limits: their rows and sectors, view by view.

    The processor cannot predict which points these are, so they are collected without a branch.
    """
    limits, group_limits = polygons.limits, polygons.group_limits
    groups, group_rows, group_offsets, coarse = points.groups, points.group_rows, points.group_offsets, points.coarse
    frames, begins, rows, places = room.frames, room.begins, room.rows, room.places
    sectors, squares, is_near = room.sectors, room.squares, room.is_near
    found = 0
    for view in range(views):
        i, j = room.scans[view]
        frame = (
            np.float32(frames[view, 0]),
            np.float32(frames[view, 1]),
            np.float32(frames[view, 2]),
            np.float32(frames[view, 3]),
        )
        first, count = group_offsets[j], group_offsets[j + 1] - group_offsets[j]
        sectors_of(frame, groups, first, first + count, WIDE_SECTORS, sectors, squares)
        for g in range(count):
            is_near[g] = squares[g] < group_limits[i, sectors[g]]
        is_near[count] = False
        g = 0
        while g < count:
            if not is_near[g]:
                g += 1
                continue
            begin = group_rows[first + g]
            while is_near[g]:
                g += 1
            end = group_rows[first + g]
            sectors_of(frame, coarse, begin, end, SECTORS, sectors, squares)
            for k in range(end - begin):
                rows[found], places[found] = begin + k, sectors[k]
                found += int(squares[k] < limits[i, sectors[k]])
        begins[view + 1] = found


@kernel(error_model="numpy")
def keep_inside(views, polygons, points, beams, room):
    """Of these, the points inside, with their positions in the frame of the view and their wedges."""
    corners, ends, rays, wedges = polygons.corners, points.xy, beams.rays, beams.wedges
    begins, rows, places, xy = room.begins, room.rows, room.places, room.xy
    found, begin = 0, 0
    for view in range(views):
        i, end = room.scans[view, 0], begins[view + 1]
        mine, first = beams.laser_of[i], polygons.offsets[i]
        count, passes = beams.counts[mine], beams.most_passed[mine]
        tx, ty, c, s = room.frames[view]
        for n in range(begin, end):
            row = rows[n]
            x, y = tx + c * ends[row, 0] - s * ends[row, 1], ty + s * ends[row, 0] + c * ends[row, 1]
            sector = places[n]
            if x * x + y * y < polygons.near2:
                sector = sector_of(x, y, SECTORS)
            k = int(wedges[mine, sector, 0])
            for _ in range(passes):
                # The point is in a later wedge if it is beyond the next ray, within a quarter turn.
                after = k + 1 if k + 1 < count else 0
                ray_x, ray_y = rays[mine, after, 0], rays[mine, after, 1]
                k += int(ray_x * y - ray_y * x >= 0.0) & int(ray_x * x + ray_y * y > 0.0)
                k = k if k < count else 0
            v = first + k
            rows[found], places[found], xy[0, found], xy[1, found] = row, k, x, y
            found += int(corners[2, v] * (y - corners[1, v]) - corners[3, v] * (x - corners[0, v]) > 0.0)
        begin = end
        begins[view + 1] = found


@kernel(inline="always")
def squared_distance(x, y, x0, y0, ex, ey, inverse):
    """The squared distance from a point to the side from (x0, y0) by (ex, ey)."""
    dx, dy = x - x0, y - y0
    share = min(max((dx * ex + dy * ey) * inverse, 0.0), 1.0)
    dx -= share * ex
    dy -= share * ey
    return dx * dx + dy * dy


@kernel(inline="always")
def may_be_nearer(x, y, ray_x, ray_y, nearest):
    """Whether a side beyond a ray may be nearer to a point than ``nearest``, a squared distance.

    At an angle a to the point's bearing, nothing beyond it is nearer than r sin(a), or r beyond a quarter turn.
    """
    cross = ray_x * y - ray_y * x
    return (cross * cross if ray_x * x + ray_y * y > 0.0 else x * x + y * y) < nearest


@kernel(error_model="numpy")
def find_depths(views, polygons, beams, room):
    """The depths of these points inside the polygon, metres; points of depth zero are left out.

    The search begins with the wedge of the point and its two neighbours, which is mostly enough, and goes on to both
    sides.
    """
    corners, rays = polygons.corners, beams.rays
    begins, rows, places, xy, depths = room.begins, room.rows, room.places, room.xy, room.depths
    deep, begin = 0, 0
    for view in range(views):
        i, end = room.scans[view, 0], begins[view + 1]
        mine, first = beams.laser_of[i], polygons.offsets[i]
        count = beams.counts[mine]
        for n in range(begin, end):
            x, y, k = xy[0, n], xy[1, n], places[n]
            left = k - 1 if k > 0 else count - 1
            nearest = np.inf
            for v in range(first + left, first + left + 3):
                d2 = squared_distance(x, y, corners[0, v], corners[1, v], corners[2, v], corners[3, v], corners[4, v])
                nearest = min(nearest, d2)
            right = left + 3
            right = right if right < count else right - count
            seen = 3
            while seen < count and may_be_nearer(x, y, rays[mine, left, 0], rays[mine, left, 1], nearest):
                left = left - 1 if left > 0 else count - 1
                v = first + left
                d2 = squared_distance(x, y, corners[0, v], corners[1, v], corners[2, v], corners[3, v], corners[4, v])
                nearest = min(nearest, d2)
                seen += 1
            while seen < count and may_be_nearer(x, y, rays[mine, right, 0], rays[mine, right, 1], nearest):
                v = first + right
                d2 = squared_distance(x, y, corners[0, v], corners[1, v], corners[2, v], corners[3, v], corners[4, v])
                nearest = min(nearest, d2)
                right = right + 1 if right + 1 < count else 0
                seen += 1
            rows[deep], depths[deep] = rows[n], math.sqrt(nearest)
            deep += int(nearest > 0.0)
        begin = end
        begins[view + 1] = deep


@kernel
def compare(pairs, stands, polygons, points, lasers, beams, block, room):
    """The depths, metres, of both scans' end points in the other's polygon, for the pairs in ``block``."""
    views = look(pairs, stands, lasers, block, room)
    find_near(views, polygons, points, room)
    keep_inside(views, polygons, points, beams, room)
    find_depths(views, polygons, beams, room)


@kernel
def sum_without_largest(values, count, dropped):
    """The sum of the first ``count`` values without the ``dropped`` largest; reorders them (quickselect)."""
    keep = count - dropped
    if keep <= 0:
        return 0.0
    low, high = 0, count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if keep - 1 <= j:
            high = j
        elif keep - 1 >= i:
            low = i
        else:
            break
    total = 0.0
    for k in range(keep):
        total += values[k]
    return total


@kernel
def by_second(pairs, n):
    """The rows of pairs (k, 2) of n scans, sorted by their second scan (a stable counting sort)."""
    begins = np.zeros(n + 1, np.int64)
    for row in range(pairs.shape[0]):
        begins[pairs[row, 1] + 1] += 1
    for j in range(n):
        begins[j + 1] += begins[j]
    order = np.empty(pairs.shape[0], np.int64)
    for row in range(pairs.shape[0]):
        order[begins[pairs[row, 1]]] = row
        begins[pairs[row, 1]] += 1
    return order


@kernel
def measure_pairs(pairs, stands, polygons, points, lasers, beams, drop, measured):
    """MC (2) for pairs of scans (k, 2): ``measured`` (k, 4) takes n_ij, M_ij, and both without the largest depths.

    ``stands``: (k, 2), the rows of ``lasers`` with the poses of each pair's scans. ``drop``: a `Drop`.
    """
    room = room_for(points)
    begins, depths = room.begins, room.depths
    # Sorted by the second scan, so that it and the few first scans of these pairs stay in the cache.
    order = by_second(pairs, points.offsets.shape[0] - 1)
    for start in range(0, order.shape[0], BLOCK):
        block = order[start : start + BLOCK]
        compare(pairs, stands, polygons, points, lasers, beams, block, room)
        for n in range(block.shape[0]):
            begin, end, total = begins[2 * n], begins[2 * n + 2], 0.0
            for k in range(begin, end):
                total += depths[k]
            count = end - begin
            dropped = min(count, max(drop.points, int(math.ceil(drop.share * count))))
            row = block[n]
            measured[row, 0], measured[row, 1] = count, total
            if dropped > 0:
                total = sum_without_largest(depths[begin:end], count, dropped)
            measured[row, 2], measured[row, 3] = count - dropped, total


@kernel
def mark_points(pairs, least_depths, polygons, points, lasers, beams, marks):
    """Counts in ``marks``, (returns,), for each end point the pairs in which its depth is at least this, (k,),
    metres."""
    room = room_for(points)
    begins, rows, depths = room.begins, room.rows, room.depths
    for start in range(0, pairs.shape[0], BLOCK):
        block = np.arange(start, min(start + BLOCK, pairs.shape[0]))
        compare(pairs, pairs, polygons, points, lasers, beams, block, room)
        for n in range(block.shape[0]):
            for k in range(begins[2 * n], begins[2 * n + 2]):
                if depths[k] >= least_depths[block[n]]:
                    marks[rows[k]] += 1
