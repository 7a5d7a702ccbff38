"""Kernels of the pairwise measure, MC (1) and (2). Their plain twins stand in tests/reference.

Scans lie end to end. ``polygons`` = (vertices, offsets, reach2): a scan's visibility polygon is a row a vertex, by
bearing: its distance from the laser, metres, 0 where the polygon comes back to the laser, and one over the squared
length of the side to the next vertex, (total, 2); where each scan begins, (n + 1,); the largest squared radius in each
sector, (n, SECTORS). ``points`` = (xy, offsets, circles, circle_offsets): the end points in the laser's frame, and
circles (x, y, radius) about every POINTS_A_CIRCLE of them. ``lasers``: (n, 4) x, y, cosine and sine of the heading in
the map. ``beams`` = (rays, first_wedges, most_passed, counts, laser): by laser the directions of its vertices as
unit vectors, (lasers, most, 2), all around and less than half a turn apart; the wedge, from each vertex to the next, in
which each bin of the pseudo-angle begins, (lasers, BINS); how many rays lie in one bin at most; and the number of
vertices; by scan its laser.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

BINS = 4096
"""Bins of the pseudo-angle over a full turn, some 0.09 degrees each: a bearing's wedge is found in a step or two."""

BINS_A_SECTOR = 64
SECTORS = BINS // BINS_A_SECTOR
"""Sectors are coarse bins: how far a polygon reaches in each tells which points can't be inside."""

POINTS_A_CIRCLE = 12
"""Neighbouring end points that are looked at together: where their circle is out of reach, all of them are."""


@njit(cache=True, nogil=True, inline="always")
def pseudo_bin(x, y):
    """The bin of a bearing: y / (|x| + |y|), which rises with the angle, unrolled to four quarters of a turn."""
    q = y / (abs(x) + abs(y))
    unrolled = math.copysign(2.0, y) - q if x < 0.0 else q
    # Rounding may carry half a turn onto the end of the last bin.
    return min(int((unrolled + 2.0) * (BINS / 4.0)), BINS - 1)


@njit(cache=True, nogil=True, inline="always")
def squared_distance_to_side(x, y, k, after, vertices, rays):
    x0, y0 = vertices[k, 0] * rays[k, 0], vertices[k, 0] * rays[k, 1]
    ex, ey = vertices[after, 0] * rays[after, 0] - x0, vertices[after, 0] * rays[after, 1] - y0
    dx, dy = x - x0, y - y0
    share = min(max((dx * ex + dy * ey) * vertices[k, 1], 0.0), 1.0)
    dx -= share * ex
    dy -= share * ey
    return dx * dx + dy * dy


@njit(cache=True, nogil=True)
def squared_depth(x, y, k, vertices, rays):
    """The squared distance from a point inside, in wedge k, to the nearest side of the polygon ``vertices`` (count, 2).

    From the point's own wedge the search goes outward to both sides. Nothing beyond a ray at an angle a from the
    point's bearing comes nearer to it than r sin(a), or r beyond a quarter turn: it ends where that is too far.
    """
    count = vertices.shape[0]
    after = k + 1 if k + 1 < count else 0
    nearest = squared_distance_to_side(x, y, k, after, vertices, rays)
    r2 = x * x + y * y
    for direction in (-1, 1):
        vertex = k if direction < 0 else after
        for _ in range(count - 1):
            cross = rays[vertex, 0] * y - rays[vertex, 1] * x
            dot = rays[vertex, 0] * x + rays[vertex, 1] * y
            if (cross * cross if dot > 0.0 else r2) >= nearest:
                break
            following = vertex + direction
            if following < 0 or following == count:
                following -= direction * count
            side, end = (following, vertex) if direction < 0 else (vertex, following)
            nearest = min(nearest, squared_distance_to_side(x, y, side, end, vertices, rays))
            vertex = following
    return nearest


@njit(cache=True, nogil=True)
def sector_reach(vertices, offsets, beams, reach2):
    """The largest squared radius of each scan's polygon in each sector of the pseudo-angle: ``reach2`` (n, SECTORS)."""
    _, first_wedges, _, counts, laser = beams
    for i in range(offsets.shape[0] - 1):
        first, count = offsets[i], counts[laser[i]]
        if offsets[i + 1] == first:
            continue
        wedges = first_wedges[laser[i]]
        for sector in range(SECTORS):
            begin = sector * BINS_A_SECTOR
            # The sector ends in the wedge in which the next one begins, and that ends with its second vertex.
            k, last = int(wedges[begin]), int(wedges[(begin + BINS_A_SECTOR) % BINS])
            steps = (last - k) % count
            if steps == 0 and int(wedges[begin + BINS_A_SECTOR // 2]) != k:
                steps = count
            largest = 0.0
            for step in range(steps + 2):
                largest = max(largest, vertices[first + (k + step) % count, 0])
            reach2[i, sector] = largest * largest


@njit(cache=True, nogil=True)
def may_reach(x, y, radius, reach2):
    """Whether a polygon whose sectors reach as far as ``reach2`` can hold a point of the circle about (x, y)."""
    d2 = x * x + y * y
    if d2 <= radius * radius:
        return True
    nearest = math.sqrt(d2) - radius
    nearest2 = nearest * nearest
    # The two tangents from the laser to the circle.
    tangent = math.sqrt(d2 - radius * radius)
    right = pseudo_bin(tangent * x + radius * y, tangent * y - radius * x) // BINS_A_SECTOR
    left = pseudo_bin(tangent * x - radius * y, tangent * y + radius * x) // BINS_A_SECTOR
    sector = right
    while True:
        if reach2[sector] > nearest2:
            return True
        if sector == left:
            return False
        sector = sector + 1 if sector + 1 < SECTORS else 0


@njit(cache=True, nogil=True)
def depths_of_scan(i, j, here, there, polygons, points, beams, room, depths, which):
    """The depths, metres, of scan j's end points in scan i's polygon, where they are inside; gives their number.

    ``here`` and ``there``: (4,), where the two lasers stand. ``depths`` and ``which`` take the depths and the rows of
    the points; ``room`` = (xy (most, 2), wedges (most,)) is used on the way.
    """
    vertices, starts, reach2 = polygons
    ends, end_starts, circles, circle_starts = points
    rays, first_wedges, most_passed, counts, laser = beams
    inside, wedges = room
    if starts[i + 1] == starts[i]:
        return 0
    count, passes = counts[laser[i]], most_passed[laser[i]]
    my_vertices, my_reach2 = vertices[starts[i] : starts[i + 1]], reach2[i]
    my_rays, my_wedges = rays[laser[i]], first_wedges[laser[i]]
    # Scan j's laser as scan i's sees it.
    dx, dy = there[0] - here[0], there[1] - here[1]
    ci, si, cj, sj = here[2], here[3], there[2], there[3]
    tx, ty = ci * dx + si * dy, -si * dx + ci * dy
    c, s = ci * cj + si * sj, ci * sj - si * cj
    found = 0
    for b in range(circle_starts[j], circle_starts[j + 1]):
        x, y = tx + c * circles[b, 0] - s * circles[b, 1], ty + s * circles[b, 0] + c * circles[b, 1]
        if not may_reach(x, y, circles[b, 2], my_reach2):
            continue
        begin = end_starts[j] + (b - circle_starts[j]) * POINTS_A_CIRCLE
        for row in range(begin, min(begin + POINTS_A_CIRCLE, end_starts[j + 1])):
            x, y = tx + c * ends[row, 0] - s * ends[row, 1], ty + s * ends[row, 0] + c * ends[row, 1]
            at_laser = x == 0.0 and y == 0.0
            k = int(my_wedges[pseudo_bin(1.0 if at_laser else x, y)])
            after = k + 1 if k + 1 < count else 0
            for _ in range(passes):
                # The next ray is passed where the point lies beyond it, within a quarter turn.
                ray_x, ray_y = my_rays[after, 0], my_rays[after, 1]
                passed = (ray_x * y - ray_y * x >= 0.0) & (ray_x * x + ray_y * y > 0.0)
                k = after if passed else k
                after = k + 1 if k + 1 < count else 0
            x0, y0 = my_vertices[k, 0] * my_rays[k, 0], my_vertices[k, 0] * my_rays[k, 1]
            ex, ey = my_vertices[after, 0] * my_rays[after, 0] - x0, my_vertices[after, 0] * my_rays[after, 1] - y0
            # Nobody can foresee which points are inside: they are gathered without a branch.
            inside[found, 0], inside[found, 1] = x, y
            wedges[found] = k
            which[found] = row
            found += int(ex * (y - y0) - ey * (x - x0) > 0.0)
    deep = 0
    for n in range(found):
        d2 = squared_depth(inside[n, 0], inside[n, 1], wedges[n], my_vertices, my_rays)
        if d2 > 0.0:
            depths[deep] = math.sqrt(d2)
            which[deep] = which[n]
            deep += 1
    return deep


@njit(cache=True, nogil=True)
def sum_without_largest(values, count, dropped):
    """The sum of the first ``count`` values but the ``dropped`` largest; reorders them (quickselect)."""
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


@njit(cache=True, nogil=True)
def measure_pairs(pairs, stands, polygons, points, lasers, beams, drop, measured):
    """MC (2) for pairs of scans (k, 2): ``measured`` (k, 4) takes n_ij, M_ij, and both without the largest depths.

    ``stands``: (k, 2), the rows of ``lasers`` where the scans of each pair stand. ``drop`` = (how many of a pair's
    largest depths are left out at least, which share of them at least).
    """
    end_starts = points[1]
    most = 0
    for row in range(end_starts.shape[0] - 1):
        most = max(most, end_starts[row + 1] - end_starts[row])
    # Gathering without a branch writes one place beyond the last.
    depths, which = np.empty(2 * most), np.empty(2 * most + 1, np.int64)
    room = (np.empty((most + 1, 2)), np.empty(most + 1, np.int64))
    for row in range(pairs.shape[0]):
        i, j = pairs[row, 0], pairs[row, 1]
        here, there = lasers[stands[row, 0]], lasers[stands[row, 1]]
        n = depths_of_scan(i, j, here, there, polygons, points, beams, room, depths, which)
        n += depths_of_scan(j, i, there, here, polygons, points, beams, room, depths[n:], which)
        total = 0.0
        for k in range(n):
            total += depths[k]
        dropped = min(n, max(int(drop[0]), math.ceil(drop[1] * n)))
        measured[row, 0], measured[row, 1] = n, total
        measured[row, 2], measured[row, 3] = n - dropped, sum_without_largest(depths, n, dropped)


@njit(cache=True, nogil=True)
def mark_points(pairs, least_depths, polygons, points, lasers, beams, marks):
    """Counts in ``marks``, (returns,), for each end point the pairs in which it lies at least so deep, (k,), metres."""
    end_starts = points[1]
    most = 0
    for row in range(end_starts.shape[0] - 1):
        most = max(most, end_starts[row + 1] - end_starts[row])
    depths, which = np.empty(most), np.empty(most + 1, np.int64)
    room = (np.empty((most + 1, 2)), np.empty(most + 1, np.int64))
    for row in range(pairs.shape[0]):
        for side in range(2):
            i, j = pairs[row, side], pairs[row, 1 - side]
            n = depths_of_scan(i, j, lasers[i], lasers[j], polygons, points, beams, room, depths, which)
            for k in range(n):
                if depths[k] >= least_depths[row]:
                    marks[which[k]] += 1


@njit(cache=True, nogil=True)
def overlapping(i, boxes, cells, order, starts, width, found):
    """The number of scans after i whose boxes overlap its box; ``found`` takes them, rising, where it is not empty.

    ``boxes``: (n, 4) low x, low y, high x, high y. Scans are filed by the cell of their box's low corner: ``order``
    lists them by cell (row after row of ``width`` cells), ``starts`` where each cell's begin. No box is wider than a
    cell, so that a box that overlaps begins in one of the nine cells around.
    """
    count = 0
    height = (starts.shape[0] - 1) // width
    row, column = cells[i] // width, cells[i] % width
    for r in range(max(row - 1, 0), min(row + 2, height)):
        for c in range(max(column - 1, 0), min(column + 2, width)):
            for k in range(starts[r * width + c], starts[r * width + c + 1]):
                j = order[k]
                if j <= i:
                    continue
                apart = (
                    boxes[j, 0] > boxes[i, 2]
                    or boxes[i, 0] > boxes[j, 2]
                    or boxes[j, 1] > boxes[i, 3]
                    or boxes[i, 1] > boxes[j, 3]
                )
                if not apart:
                    if found.shape[0] > 0:
                        found[count] = j
                    count += 1
    if found.shape[0] > 0:
        found[:count].sort()
    return count


@njit(cache=True, nogil=True)
def count_overlapping(boxes, cells, order, starts, width, counts):
    """How many scans after it overlap each scan, ``counts`` (n,)."""
    nowhere = np.empty(0, np.int64)
    for i in range(boxes.shape[0]):
        if not boxes[i, 0] > boxes[i, 2]:
            counts[i] = overlapping(i, boxes, cells, order, starts, width, nowhere)


@njit(cache=True, nogil=True)
def list_overlapping(first, last, boxes, cells, grid, counts, pairs):
    """The overlapping pairs (i, j), i < j, of the scans from ``first`` to before ``last``, in order, into ``pairs``.

    ``grid`` = (order, starts, width) as in ``overlapping``.
    """
    order, starts, width = grid
    filled = 0
    for i in range(first, last):
        if counts[i] == 0:
            continue
        found = np.empty(counts[i], np.int64)
        overlapping(i, boxes, cells, order, starts, width, found)
        for k in range(counts[i]):
            pairs[filled, 0] = i
            pairs[filled, 1] = found[k]
            filled += 1
