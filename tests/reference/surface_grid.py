"""The plain twin of grid/_kernels.py: places as complex numbers, cells in a dictionary, the nearest by trying all."""

import cmath
import math

REACH = 4
MEAN_MEMORY = 40
RETURN_WEIGHT = 3
MOST_EVIDENCE = 100
CLEARANCE_CELLS = 1.5
GAP_FLOOR_M = 0.03


def project_scan(ranges, bearings_rad, limits, mounting):
    """Rows (x, y, normal x, normal y) of the usable readings in the robot's frame."""
    shortest, longest, gap = limits
    places = [r * cmath.exp(1j * b) for r, b in zip(ranges, bearings_rad, strict=True)]
    turn = cmath.exp(1j * mounting[2])
    rows = []
    for k, r in enumerate(ranges):
        if not shortest <= r <= longest:
            continue
        normal = 0j
        if 0 < k < len(ranges) - 1:
            steps = [abs(ranges[k - 1] - r), abs(ranges[k + 1] - r)]
            if all(step < gap * r + GAP_FLOOR_M for step in steps):
                chord = places[k + 1] - places[k - 1]
                if abs(chord) > 1e-6:
                    normal = 1j * chord / abs(chord)
                    if (normal * places[k].conjugate()).real > 0.0:
                        normal = -normal
        place = complex(mounting[0], mounting[1]) + turn * places[k]
        normal *= turn
        rows.append((place.real, place.imag, normal.real, normal.imag))
    return rows


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
        places = [here + turn * complex(x, y) for x, y, _, _ in points]
        normals = [turn * complex(nx, ny) for _, _, nx, ny in points]
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
            old = self.mean.get(cell, (0.0,) * 5)
            # All normals of a cell look to the side that was seen first.
            side = -1.0 if (normal * complex(old[2], -old[3])).real < 0.0 else 1.0
            new = (place.real, place.imag, side * normal.real, side * normal.imag, side)
            share = 1.0 / self.returns[cell]
            self.mean[cell] = tuple((1.0 - share) * o + share * n for o, n in zip(old, new, strict=True))

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
