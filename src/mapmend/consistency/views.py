"""What scans saw, without their poses, and where this is in a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]


class Polygons(NamedTuple):
    """The visibility polygons of n scans, one after the other, each in the frame of its laser.

    ``corners``: (5, total), a column for each vertex, by bearing: x, y, the side to the next vertex, and one over its
    squared length; (0, 0) where the polygon returns to the laser. After a scan's last vertex its first ones are
    repeated. ``offsets``: (n + 1,), where each scan begins. ``limits``: (n, SECTORS), squared distances: in a sector of
    the pseudo-angle, no point farther out is in the polygon. ``group_limits``: (n, WIDE_SECTORS): no group of points
    whose middle is farther out touches it. ``near2``: a squared distance; for points nearer to the laser, float32 is
    too coarse to find the sector.
    """

    corners: Float
    offsets: Int
    limits: Single
    group_limits: Single
    near2: float


class EndPoints(NamedTuple):
    """The end points of n scans, one scan after the other, each in the frame of its laser.

    ``xy``: (returns, 2); ``offsets``: (n + 1,), where each scan begins. Neighbouring points are in groups: ``groups``:
    (2, g), their middles; ``group_rows``: (g + 1,), their first points; ``group_offsets``: (n + 1,), where each scan's
    groups begin. ``coarse``: (2, returns), the points as float32.
    """

    xy: Float
    offsets: Int
    groups: Single
    group_rows: Int
    group_offsets: Int
    coarse: Single


class Beams(NamedTuple):
    """What all polygons of one laser have in common, by laser. Beams are counted from right to left.

    ``rays``: (lasers, most, 2), the directions of the vertices as unit vectors, less than half a turn apart; the last
    one points into the middle of the blind side, if there is one: there the polygon returns to the laser. ``wedges``:
    (lasers, SECTORS, 2), the wedges, from each vertex to the next, in which each sector begins and ends.
    ``most_passed``: (lasers,), the greatest number of rays in one sector. ``counts``: (lasers,), of vertices.
    ``laser_of``: (n,), the laser of each scan.
    """

    rays: Float
    wedges: NDArray[np.int32]
    most_passed: Int
    counts: Int
    laser_of: Int


@dataclass(frozen=True)
class ScanViews:
    """The visibility polygons and end points of n scans, each in the frame of its laser: they do not depend on poses.

    ``ends``: (readings, 2), the ends of the free parts of all beams, also of those without return; ``end_offsets``:
    (n + 1,). ``mountings``: (lasers, 3), ``T_robot_laser``.
    """

    polygons: Polygons
    points: EndPoints
    beams: Beams
    ends: Float
    end_offsets: Int
    mountings: Float

    def __len__(self) -> int:
        return len(self.beams.laser_of)

    def lasers_at(self, poses: Float, rows: Int | None = None) -> Float:
        """The lasers of all scans, or of the given ``rows``, where the robot is at ``poses``, (k, 3), ``T_map_robot``.

        x, y, cosine and sine of the heading: (k, 4).
        """
        laser_of = self.beams.laser_of
        laser = compose(poses, self.mountings[laser_of if rows is None else laser_of[rows]])
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


@dataclass(frozen=True)
class PlacedViews:
    """What n scans saw, in a map. ``lasers``: (n, 4), x, y, cosine and sine of each scan's laser there."""

    scans: ScanViews
    lasers: Float

    def __len__(self) -> int:
        return len(self.lasers)

    def points_in_map(self) -> Float:
        """All end points in the map's frame, (returns, 2)."""
        return _placed(self.lasers, self.scans.points.xy, np.diff(self.scans.points.offsets))

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


def _placed(lasers: Float, points: Float, counts: Int) -> Float:
    """Points of scans, (sum of counts, 2), in the map."""
    x, y, cos, sin = np.repeat(lasers, counts, axis=0).T
    px, py = points.T
    return np.stack((x + cos * px - sin * py, y + sin * px + cos * py), axis=1)
