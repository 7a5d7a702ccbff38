"""The kernel that turns a scan into points with normals. Its plain twin is in tests/reference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

# Neighbouring points farther apart than this are never one wall, even if they are on a line.
MOST_CHORD_M = 5.0
# A post or a leg is at most this many times as wide as the least distance of neighbours.
MOST_THIN_BEAMS = 4
# Neighbours are at most this many beams away: 10 degrees of a common dense laser, for things at arm's length.
MOST_AWAY = 40


class Laser(NamedTuple):
    """A laser on a robot, and the limits within which its points are on one surface.

    ``cosines``, ``sines`` (beams,): of the beams' bearings. ``mounting`` (3,): the laser's pose on the robot.
    ``min_range_m``, ``max_range_m``: the usable ranges. ``surface_gap``: the largest difference to a neighbour's range
    on one surface, as a share of the range. ``wall_std_m``: a point farther from its neighbours is still on one wall
    with them up to this distance from their chord. ``least_away``: the least number of beams to a neighbour;
    ``away_m``: that number times the range.
    """

    cosines: NDArray[np.float64]
    sines: NDArray[np.float64]
    mounting: NDArray[np.float64]
    min_range_m: float
    max_range_m: float
    surface_gap: float
    wall_std_m: float
    least_away: int
    away_m: float


@kernel
def project_scan(ranges, laser, points):
    """Returns of one scan as points with normals in the robot's frame: rows (x, y, normal x, normal y, thin).

    ``ranges`` (beams,), ``laser`` a `Laser`, ``points`` (beams, 5): written. The normal is that of the chord
    between the two neighbours, towards the laser; (0, 0) if they are on different surfaces.
    The points of a wall seen at a grazing angle are far apart, but on one line. "thin" is 1 for the points of a post or
    a leg, which constrain the pose in every direction, else 0. Returns the number of rows written.
    """
    cosines, sines, mounting = laser.cosines, laser.sines, laser.mounting
    count = 0
    beams = ranges.shape[0]
    cos_m, sin_m = math.cos(mounting[2]), math.sin(mounting[2])
    for k in range(beams):
        r = float(ranges[k])
        if not (laser.min_range_m <= r <= laser.max_range_m):
            continue
        x, y = r * cosines[k], r * sines[k]
        nx, ny = 0.0, 0.0
        away = max(laser.least_away, min(int(laser.away_m / r), MOST_AWAY))
        if away <= k < beams - away:
            i, j = k - away, k + away
            before, after = float(ranges[i]), float(ranges[j])
            gap = laser.surface_gap * r + laser.wall_std_m
            bx, by = before * cosines[i], before * sines[i]
            tx, ty = after * cosines[j] - bx, after * sines[j] - by
            length = math.sqrt(tx * tx + ty * ty)
            if 1e-6 < length < MOST_CHORD_M:
                near = abs(before - r) < gap and abs(after - r) < gap
                # On a straight wall the inverse ranges change evenly; from a jamb to the surface behind it they do not.
                between = (before - r) * (after - r) < 0.0 and abs(2.0 * before * after / (before + after) - r) < gap
                if near or (between and abs(tx * (y - by) - ty * (x - bx)) < laser.wall_std_m * length):
                    nx, ny = -ty / length, tx / length
                    if nx * x + ny * y > 0.0:
                        nx, ny = -nx, -ny
        points[count, 0] = mounting[0] + cos_m * x - sin_m * y
        points[count, 1] = mounting[1] + sin_m * x + cos_m * y
        points[count, 2] = cos_m * nx - sin_m * ny
        points[count, 3] = sin_m * nx + cos_m * ny
        points[count, 4] = (
            1.0 if _is_thin(ranges, k, laser.surface_gap * r + laser.wall_std_m, laser.least_away) else 0.0
        )
        count += 1
    return count


@kernel
def _is_thin(ranges, k, gap, away):
    """Whether beam k hits one of a few neighbouring points with only farther things beside them on both sides.

    The last point of a wall before its end, or before the laser's range ends, does not count: it moves with the robot.
    """
    width = 1
    for step in (-1, 1):
        i = k + step
        while 0 <= i < ranges.shape[0] and abs(ranges[i] - ranges[k]) < gap and width <= MOST_THIN_BEAMS * away:
            width += 1
            i += step
        if not (0 <= i < ranges.shape[0] and ranges[i] > ranges[k] + gap):
            return False
    return width <= MOST_THIN_BEAMS * away
