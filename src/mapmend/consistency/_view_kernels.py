"""Kernels that prepare scans for comparison: the reach of polygons by sector, and groups of end points."""

from __future__ import annotations

import math

import numpy as np

from mapmend.kernel_cache import kernel


@kernel(inline="always")
def squared_reach(ray_x, ray_y, x, y, ex, ey):
    """The squared length of a ray within the triangle of the laser and the side (ex, ey) that begins at (x, y)."""
    ends = max(x * x + y * y, (x + ex) ** 2 + (y + ey) ** 2)
    area, across = x * ey - y * ex, ray_x * ey - ray_y * ex
    if area <= 0.0:
        return 0.0
    return min(area * area, ends * across * across) / (across * across) if across > 0.0 else ends


@kernel
def sector_reach(corners, offsets, counts, laser, edges, wedges, reach2):
    """The largest squared radius of each scan's polygon in each sector of the pseudo-angle: ``reach2`` (n, sectors).

    ``edges``: (sectors, 4), unit vectors along the two edges of each sector, slightly outside; ``wedges``: (lasers,
    sectors, 2), the wedges of these edges. Between the edges, the farthest point of a polygon is a vertex.
    """
    for i in range(offsets.shape[0] - 1):
        if offsets[i + 1] == offsets[i]:
            continue
        first, mine = offsets[i], laser[i]
        for sector in range(reach2.shape[1]):
            k, last = int(wedges[mine, sector, 0]), int(wedges[mine, sector, 1])
            u, v = first + k, first + last
            largest = squared_reach(
                edges[sector, 0], edges[sector, 1], corners[0, u], corners[1, u], corners[2, u], corners[3, u]
            )
            other = squared_reach(
                edges[sector, 2], edges[sector, 3], corners[0, v], corners[1, v], corners[2, v], corners[3, v]
            )
            largest = max(largest, other)
            while k != last:
                k = k + 1 if k + 1 < counts[mine] else 0
                u = first + k
                largest = max(largest, corners[0, u] ** 2 + corners[1, u] ** 2)
            reach2[i, sector] = largest


@kernel
def group_reach(reach2, gap_sines, radius, reach2_of_groups):
    """For each sector, the squared distance beyond which a circle with its middle there cannot touch the polygon.

    ``reach2``: (n, sectors) as above; ``gap_sines``: (wide sectors, wide sectors), the sine of the angle between two
    of the wider ones, 0 for neighbours, 1 from a quarter turn on. ``reach2_of_groups``: (n, wide sectors). A point
    within ``radius`` of a ray, at an angle a to it, is no farther out than the ray's end plus the radius, nor than
    radius / sin a.
    """
    wide = reach2_of_groups.shape[1]
    each = reach2.shape[1] // wide
    reach = np.empty(wide)
    for i in range(reach2.shape[0]):
        for s in range(wide):
            largest = 0.0
            for k in range(s * each, (s + 1) * each):
                largest = max(largest, float(reach2[i, k]))
            reach[s] = math.sqrt(largest)
        for s in range(wide):
            largest = 0.0
            for other in range(wide):
                if reach[other] > 0.0:
                    out = reach[other] + radius
                    largest = max(largest, min(out, radius / gap_sines[s, other]) if gap_sines[s, other] > 0.0 else out)
            reach2_of_groups[i, s] = largest * largest


@kernel
def group_points(xy, offsets, most, radius, middles, first_rows):
    """Cuts each scan's end points, (returns, 2), into groups of neighbours, ``most`` at most, within ``radius``.

    Writes the groups into ``middles``: (2, returns) and ``first_rows``: (returns,); returns the number for each scan,
    (n,).
    """
    counts = np.zeros(offsets.shape[0] - 1, np.int64)
    total = 0
    for i in range(offsets.shape[0] - 1):
        row = offsets[i]
        while row < offsets[i + 1]:
            first_rows[total] = row
            low_x, low_y = xy[row, 0], xy[row, 1]
            high_x, high_y = low_x, low_y
            row += 1
            while row < min(offsets[i + 1], first_rows[total] + most):
                x0, y0 = min(low_x, xy[row, 0]), min(low_y, xy[row, 1])
                x1, y1 = max(high_x, xy[row, 0]), max(high_y, xy[row, 1])
                if (x1 - x0) ** 2 + (y1 - y0) ** 2 > 4.0 * radius * radius:
                    break
                low_x, low_y, high_x, high_y = x0, y0, x1, y1
                row += 1
            middles[0, total], middles[1, total] = (low_x + high_x) / 2.0, (low_y + high_y) / 2.0
            counts[i] += 1
            total += 1
    return counts
