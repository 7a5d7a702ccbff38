"""What scans saw, without their poses, and where this is in a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class Beams:
    """What all polygons of one laser have in common, by laser: see ``_kernels``. Beams are counted from right to left.

    ``rays``: (lasers, most, 2): the directions of the vertices, and after them one into the middle of the blind side,
    if there is one; there the polygon returns to the laser. ``wedges``: int32, (lasers, SECTORS, 2), those of the two
    edges of a sector. ``most_passed``: (lasers,), the greatest number of rays in one sector.
    ``counts``: (lasers,), how many directions.
    """

    rays: Float
    wedges: NDArray[np.int32]
    most_passed: Int
    counts: Int


@dataclass(frozen=True)
class Limits:
    """The squared reach of polygons by sector, and end points in groups: see ``_kernels``."""

    sectors: Single
    wide_sectors: Single
    near2: float
    groups: Single
    group_rows: Int
    group_offsets: Int
    points: Single


@dataclass(frozen=True)
class ScanViews:
    """The visibility polygons and end points of n scans, each in the frame of its laser: they do not depend on poses.

    ``corners``: (5, total): x and y of the polygons' vertices, by bearing, the side to the next, and one over its
    squared length; after a scan's last one its first ones are repeated. ``corner_offsets``: (n + 1,). ``points``:
    (returns, 2), end points; ``point_offsets``: (n + 1,). ``ends``: (readings, 2), the ends of the free parts of all
    beams, also of those without return; ``end_offsets``: (n + 1,). ``limits``: with these the kernels exclude points
    outside quickly. ``laser_of``: int64, (n,), into ``beams`` and ``mountings``, (lasers, 3), ``T_robot_laser``.
    """

    corners: Float
    corner_offsets: Int
    points: Float
    point_offsets: Int
    ends: Float
    end_offsets: Int
    limits: Limits
    laser_of: Int
    beams: Beams
    mountings: Float

    def __len__(self) -> int:
        return len(self.laser_of)

    def lasers_at(self, poses: Float, rows: Int | None = None) -> Float:
        """The lasers of all scans, or of the given ``rows``, where the robot is at ``poses``, (k, 3), ``T_map_robot``.

        x, y, cosine and sine of the heading: (k, 4).
        """
        laser = compose(poses, self.mountings[self.laser_of if rows is None else self.laser_of[rows]])
        return np.column_stack((laser[:, :2], np.cos(laser[:, 2]), np.sin(laser[:, 2])))

    def placed(self, poses: Float) -> PlacedViews:
        """The same in a map, the scans taken at ``poses``, (n, 3), ``T_map_robot``.

        Raises MapmendError for other shapes, and poses that are not finite.
        """
        n = len(self)
        if poses.shape != (n, 3):
            raise MapmendError(f"{n} scans need poses of shape ({n}, 3), got {poses.shape}")
        if not np.all(np.isfinite(poses)):
            raise MapmendError("the poses must be finite")
        return PlacedViews(self, self.lasers_at(poses))

    def for_kernels(self) -> tuple[Any, Any, Any]:
        """Polygons, points and beams as the kernels take them."""
        beams, limits = self.beams, self.limits
        return (
            (self.corners, self.corner_offsets, limits.sectors, limits.wide_sectors, limits.near2),
            (self.points, self.point_offsets, limits.groups, limits.group_rows, limits.group_offsets, limits.points),
            (beams.rays, beams.wedges, beams.most_passed, beams.counts, self.laser_of),
        )


@dataclass(frozen=True)
class PlacedViews:
    """What n scans saw, in a map. ``lasers``: (n, 4), x, y, cosine and sine of each scan's laser there."""

    scans: ScanViews
    lasers: Float

    def __len__(self) -> int:
        return len(self.lasers)

    def points_in_map(self) -> Float:
        """All end points in the map's frame, (returns, 2)."""
        return _placed(self.lasers, self.scans.points, np.diff(self.scans.point_offsets))

    def boxes(self) -> Float:
        """Low x, low y, high x, high y of all that each scan covers in the map, (n, 4).

        Low above high for a scan without beams.
        """
        offsets = self.scans.end_offsets
        counts = np.diff(offsets)
        boxes = np.hstack((self.lasers[:, :2], self.lasers[:, :2]))
        boxes[counts == 0] = (np.inf, np.inf, -np.inf, -np.inf)
        filled = np.flatnonzero(counts > 0)
        if len(filled):
            ends = _placed(self.lasers, self.scans.ends, counts)
            boxes[filled, :2] = np.minimum(boxes[filled, :2], np.minimum.reduceat(ends, offsets[filled]))
            boxes[filled, 2:] = np.maximum(boxes[filled, 2:], np.maximum.reduceat(ends, offsets[filled]))
        return boxes

    def for_kernels(self) -> tuple[Any, Any, Float, Any]:
        """Polygons, points, lasers and beams as the kernels take them."""
        polygons, points, beams = self.scans.for_kernels()
        return polygons, points, self.lasers, beams


def _placed(lasers: Float, points: Float, counts: Int) -> Float:
    """Points of scans, (sum of counts, 2), in the map."""
    x, y, cos, sin = np.repeat(lasers, counts, axis=0).T
    px, py = points.T
    return np.stack((x + cos * px - sin * py, y + sin * px + cos * py), axis=1)
