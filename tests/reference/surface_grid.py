"""The plain twin of grid/_kernels.py: places as complex numbers, cells in a dictionary, the nearest by trying all."""

import cmath
import math
import statistics

REACH = 4
MEAN_MEMORY = 40
RETURN_WEIGHT = 3
MOST_EVIDENCE = 100
CLEARANCE_CELLS = 1.5
MOST_CHORD_M = 5.0
MOST_THIN_BEAMS = 4
MOST_AWAY = 40


def project_scan(ranges, bearings_rad, limits, mounting):
    """Rows (x, y, normal x, normal y, thin) of the usable readings in the robot's frame."""
    shortest, longest, share, off_line_m, least_away, away_m = limits
    places = [r * cmath.exp(1j * b) for r, b in zip(ranges, bearings_rad, strict=True)]
    turn = cmath.exp(1j * mounting[2])
    rows = []
    for k, r in enumerate(ranges):
        if not shortest <= r <= longest:
            continue
        normal = 0j
        away = int(max(least_away, min(away_m / r, MOST_AWAY)))
        if away <= k < len(ranges) - away:
            i, j = k - away, k + away
            chord = places[j] - places[i]
            if 1e-6 < abs(chord) < MOST_CHORD_M:
                across = 1j * chord / abs(chord)
                near = all(abs(ranges[other] - r) < share * r + off_line_m for other in (i, j))
                ordered = ranges[i] < r < ranges[j] or ranges[i] > r > ranges[j]
                if ordered:
                    # Where a straight line crosses the middle beam, the inverse ranges being even over even angles.
                    straight = 1.0 / statistics.fmean((1.0 / ranges[i], 1.0 / ranges[j]))
                    ordered = abs(straight - r) < share * r + off_line_m
                off_line = abs((across * (places[k] - places[i]).conjugate()).real)
                if near or (ordered and off_line < off_line_m):
                    normal = -across if (across * places[k].conjugate()).real > 0.0 else across
        place = complex(mounting[0], mounting[1]) + turn * places[k]
        normal *= turn
        thin = 1.0 if is_thin(ranges, k, share * r + off_line_m, least_away) else 0.0
        rows.append((place.real, place.imag, normal.real, normal.imag, thin))
    return rows


def is_thin(ranges, k, gap_m, away):
    """Whether the beams about k that end near where it does are few, and those beside them go farther."""
    first = last = k
    while first > 0 and abs(ranges[first - 1] - ranges[k]) < gap_m:
        first -= 1
    while last < len(ranges) - 1 and abs(ranges[last + 1] - ranges[k]) < gap_m:
        last += 1
    if last - first + 1 > MOST_THIN_BEAMS * away or first == 0 or last == len(ranges) - 1:
        return False
    return all(ranges[beside] > ranges[k] + gap_m for beside in (first - 1, last + 1))


class PlainGrid:
    """Cells by (row, column): ``mean`` (x, y, normal x, normal y, side), ``returns``, ``evidence``."""

    def __init__(self, cell_size_m):
        self.size = cell_size_m
        self.mean, self.returns, self.evidence = {}, {}, {}

    def cell_of(self, place):
        return math.floor(place.imag / self.size), math.floor(place.real / self.size)

    def insert(self, points, laser_origin, pose, first, stride):
        """One scan; of its beams every ``stride``-th from ``first`` on clears what it passes through."""
        here, turn = complex(pose[0], pose[1]), cmath.exp(1j * pose[2])
        laser = here + turn * complex(laser_origin[0], laser_origin[1])
        places = [here + turn * complex(x, y) for x, y, *_ in points]
        normals = [turn * complex(nx, ny) for _, _, nx, ny, _ in points]
        for place, normal in list(zip(places, normals, strict=True))[first::stride]:
            for cell in self.passed(laser, place, normal):
                self.evidence[cell] = max(self.evidence.get(cell, 0) - 1, -MOST_EVIDENCE)
                if self.evidence[cell] == 0:
                    self.evidence[cell] = -1
                    del self.mean[cell], self.returns[cell]
        for place, normal in zip(places, normals, strict=True):
            cell = self.cell_of(place)
            self.evidence[cell] = min(max(self.evidence.get(cell, 0), 0) + RETURN_WEIGHT, MOST_EVIDENCE)
            self.returns[cell] = min(self.returns.get(cell, 0) + 1, MEAN_MEMORY)
            old = self.mean.get(cell, (0.0, 0.0, 0.0, 0.0, 1.0))
            direction = complex(old[2], old[3])
            # All normals of a cell look to the side that was seen first.
            side = -1.0 if (normal * direction.conjugate()).real < 0.0 else 1.0
            new = (place.real, place.imag, side * normal.real, side * normal.imag, side)
            share = 1.0 / self.returns[cell]
            # A return without a normal says nothing of the direction, and the first that has one all there is to say.
            share_of_normal = 0.0 if normal == 0 else share if direction != 0 else 1.0
            shares = (share, share, *[share_of_normal] * 3)
            self.mean[cell] = tuple((1.0 - s) * o + s * n for s, o, n in zip(shares, old, new, strict=True))

    def passed(self, laser, place, normal):
        """The cells that a beam says are free: one a step, up to 1.5 cells along the normal from its surface."""
        beam = place - laser
        cosine = max(abs((normal * beam.conjugate()).real) / abs(beam), 0.1) if beam else 0.1
        share = 1.0 - CLEARANCE_CELLS * self.size / (cosine * abs(beam)) if beam else 0.0
        if share <= 0.0:
            return
        way = share * beam / self.size
        steps = max(abs(way.real), abs(way.imag))
        if steps >= 1.0:
            for k in range(int(steps)):
                yield self.cell_of(laser + k * self.size * way / steps)


def nearest_distance(means, cell, cell_size_m):
    """From a cell's centre to the nearest of ``means`` (by cell) within REACH cells; inf where there is none."""
    row, column = cell
    centre = ((column + 0.5) * cell_size_m, (row + 0.5) * cell_size_m)
    return min(
        (
            math.dist(mean[:2], centre)
            for (r, c), mean in means.items()
            if abs(r - row) <= REACH and abs(c - column) <= REACH
        ),
        default=math.inf,
    )
