"""Visibility polygons: the free space that each scan has seen, MC section III.

A polygon runs through a scan's end points by bearing, and through the laser itself on the side that it does not see. It
is star-shaped about the laser, so that a point's place in it is found by its bearing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import ConsistencyConfig
from mapmend.consistency import _kernels
from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose
from mapmend.scan import LaserGeometry, Scans

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

FULL_TURN_GAP = 1.5
"""The beams go all around where less than this many increments lie between the last one and the first."""

SCANS_AT_ONCE = 2048
"""Polygons are made of so many scans at a time: memory for what lies between is bounded."""


@dataclass(frozen=True)
class Beams:
    """What the polygons of one laser share, by laser: see ``_kernels``. Beams are counted from right to left.

    ``rays``: (lasers, most, 2): the directions of the vertices, and behind them one into the middle of the blind side
    where there is one; there the polygon comes back to the laser. ``first_wedges``: int16, (lasers, BINS).
    ``most_passed``: (lasers,), how many rays lie in one bin at most. ``counts``: (lasers,), how many directions.
    """

    rays: Float
    first_wedges: NDArray[np.int16]
    most_passed: Int
    counts: Int


@dataclass(frozen=True)
class Views:
    """The visibility polygons and end points of n scans in the map.

    ``vertices``: (total, 2), their distances from the laser, metres, by bearing, and one over the squared length of the
    side to the next; ``vertex_offsets``: (n + 1,). ``reach2``: (n, SECTORS), the largest squared distance by sector.
    ``points``: (returns, 2), end points in the laser's frame; ``point_offsets``: (n + 1,); ``circles``, (c, 3), about
    every few of them. ``lasers``: (n, 4), x, y, cosine and sine of the laser in the map. ``boxes``: (n, 4), low x, low
    y, high x, high y of all that a scan covers in the map; low above high for a scan without beams. ``laser_of``:
    int64, (n,), into ``beams``.
    """

    vertices: Float
    vertex_offsets: Int
    reach2: Float
    points: Float
    point_offsets: Int
    circles: Float
    circle_offsets: Int
    lasers: Float
    boxes: Float
    laser_of: Int
    beams: Beams

    def __len__(self) -> int:
        return len(self.lasers)

    def points_in_map(self) -> Float:
        """All end points in the map's frame, (returns, 2)."""
        return _placed(self.lasers, self.points, np.diff(self.point_offsets))


def build_views(scans: Scans, poses: Float, config: ConsistencyConfig) -> Views:
    """The views of n scans taken at ``poses``, (n, 3), ``T_map_robot``; a scan without beams sees nothing.

    Readings up to ``config.max_range_m`` are end points; those beyond it count as free up to there. A beam without
    return, or too near to be one, says nothing: there the polygon comes back to the laser. Raises MapmendError for
    other shapes, poses that are not finite, and lasers whose beams lie half a turn apart.
    """
    n = len(scans)
    if poses.shape != (n, 3):
        raise MapmendError(f"{n} scans need poses of shape ({n}, 3), got {poses.shape}")
    if not np.all(np.isfinite(poses)):
        raise MapmendError("the poses must be finite")
    beams = _beams(scans.geometries)
    laser_of = scans.geometry_index.astype(np.int64)
    is_empty = np.diff(scans.offsets) == 0
    vertex_offsets = _offsets(np.where(is_empty, 0, beams.counts[laser_of]))
    vertices = np.zeros((int(vertex_offsets[-1]), 2))
    ends, is_point = np.zeros((len(scans.ranges_m), 2)), np.zeros(len(scans.ranges_m), np.bool_)
    for k, geometry in enumerate(scans.geometries):
        rows = np.flatnonzero((laser_of == k) & ~is_empty)
        rays, count = _rays(geometry), int(beams.counts[k])
        for part in np.array_split(rows, -(-len(rows) // SCANS_AT_ONCE) or 1):
            readings = scans.offsets[part, None] + _beam_order(geometry)
            reach, returned = _reach(scans.ranges_m[readings], geometry, config)
            ends[readings], is_point[readings] = reach[:, :, None] * rays, returned
            around = np.zeros((len(part), count))
            seen = min(count, geometry.beam_count)
            around[:, :seen] = reach[:, :seen]
            vertices[vertex_offsets[part, None] + np.arange(count)] = _vertices(around, beams.rays[k, :count])
    points = ends[is_point]
    point_offsets = np.concatenate(([0], np.cumsum(is_point)))[scans.offsets].astype(np.int64)
    circles, circle_offsets = _circles(points, point_offsets)
    reach2 = np.zeros((n, _kernels.SECTORS))
    kernel_beams = (beams.rays, beams.first_wedges, beams.most_passed, beams.counts, laser_of)
    _kernels.sector_reach(vertices, vertex_offsets, kernel_beams, reach2)
    lasers = _lasers(scans, poses, laser_of)
    return Views(
        vertices=vertices,
        vertex_offsets=vertex_offsets,
        reach2=reach2,
        points=points,
        point_offsets=point_offsets,
        circles=circles,
        circle_offsets=circle_offsets,
        lasers=lasers,
        boxes=_boxes(lasers, ends, scans.offsets),
        laser_of=laser_of,
        beams=beams,
    )


def _reach(ranges: NDArray[np.float32], geometry: LaserGeometry, config: ConsistencyConfig) -> tuple[Float, Bool]:
    """How far each beam is free, metres, 0 where it says nothing, and whether it ends at something."""
    readings = ranges.astype(np.float64)
    with np.errstate(invalid="ignore"):
        seen = (readings >= config.min_range_m) & (readings < geometry.max_range_m)
    longest = config.max_range_m
    reach = np.where(seen, np.minimum(np.where(seen, readings, 0.0), longest), 0.0)
    return reach, seen & (readings <= longest)


def _vertices(reach: Float, rays: Float) -> Float:
    """Distances (scans, count) with one over the squared lengths of the sides: (scans, count, 2)."""
    ends = reach[:, :, None] * rays
    length2 = np.sum((np.roll(ends, -1, axis=1) - ends) ** 2, axis=2)
    inverse = np.divide(1.0, length2, out=np.zeros_like(length2), where=length2 > 0.0)
    return np.stack((reach, inverse), axis=2)


def _beam_order(geometry: LaserGeometry) -> Int:
    """A laser's beams from right to left."""
    rows = np.arange(geometry.beam_count, dtype=np.int64)
    return rows[::-1] if geometry.angle_increment_rad < 0.0 else rows


def _rays(geometry: LaserGeometry) -> Float:
    """Unit vectors of the beams from right to left, (beams, 2)."""
    bearings = geometry.bearings_rad()[_beam_order(geometry)]
    return np.stack((np.cos(bearings), np.sin(bearings)), axis=1)


def _beams(geometries: tuple[LaserGeometry, ...]) -> Beams:
    directions = [_directions(geometry) for geometry in geometries] or [np.zeros(0)]
    most = max(len(bearings) for bearings in directions)
    rays = np.zeros((len(directions), most, 2))
    first_wedges = np.zeros((len(directions), _kernels.BINS), np.int16)
    for k, bearings in enumerate(directions):
        rays[k, : len(bearings)] = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
        if len(bearings):
            first_wedges[k] = _first_wedges(bearings)
    counts = np.array([len(bearings) for bearings in directions], dtype=np.int64)
    passed = (np.roll(first_wedges, -1, axis=1) - first_wedges) % np.maximum(counts, 1)[:, None]
    # A bin begins a hair before its place: the ray there, too, lies in it.
    return Beams(rays, first_wedges, passed.max(axis=1) + 1, counts)


def _directions(geometry: LaserGeometry) -> Float:
    """The bearings of a polygon's vertices, rising: its beams, and the middle of the blind side where there is one."""
    step = abs(geometry.angle_increment_rad)
    if step >= np.pi:
        raise MapmendError(f"a laser's beams lie {step:g} rad apart: no free space is known between them")
    if geometry.beam_count == 0:
        return np.zeros(0)
    # Beams beyond a full turn look again where the first ones look.
    count = geometry.beam_count if step == 0.0 else min(geometry.beam_count, int(2.0 * np.pi / step - 1e-6) + 1)
    bearings = geometry.bearings_rad()[_beam_order(geometry)][:count]
    blind = 2.0 * np.pi - (count - 1) * step
    if count >= 3 and blind <= FULL_TURN_GAP * step:
        return bearings
    return np.append(bearings, bearings[-1] + blind / 2.0)


def _first_wedges(bearings: Float) -> NDArray[np.int16]:
    """The wedge between two neighbouring bearings, (count,), in which each bin of the pseudo-angle begins."""
    q = np.arange(_kernels.BINS) * (4.0 / _kernels.BINS) - 2.0
    y = np.where(np.abs(q) <= 1.0, q, np.sign(q) * 2.0 - q)
    x = np.where(np.abs(q) <= 1.0, 1.0, -1.0) * (1.0 - np.abs(y))
    # A hair early: rounding must never put a point before its bin.
    beyond_first = (np.arctan2(y, x) - 1e-9 - bearings[0]) % (2.0 * np.pi)
    return (np.searchsorted(bearings - bearings[0], beyond_first, side="right") - 1).astype(np.int16)


def _offsets(counts: Int) -> Int:
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64)


def laser_places(scans: Scans, rows: Int, poses: Float) -> Float:
    """Where the lasers of the given scans stand when the robot is at ``poses``, (k, 3): x, y, cosine, sine, (k, 4)."""
    return _lasers(scans, poses, scans.geometry_index[rows].astype(np.int64))


def _lasers(scans: Scans, poses: Float, laser_of: Int) -> Float:
    mountings = np.array([g.T_robot_laser for g in scans.geometries] or [(0.0, 0.0, 0.0)], dtype=np.float64)
    laser = compose(poses, mountings[laser_of])
    return np.column_stack((laser[:, :2], np.cos(laser[:, 2]), np.sin(laser[:, 2])))


def _boxes(lasers: Float, ends: Float, offsets: Int) -> Float:
    """Low x, low y, high x, high y of lasers and all beams' ends in the map, (n, 4); low above high for empty scans."""
    counts = np.diff(offsets)
    boxes = np.hstack((lasers[:, :2], lasers[:, :2]))
    boxes[counts == 0] = (np.inf, np.inf, -np.inf, -np.inf)
    filled = np.flatnonzero(counts > 0)
    if len(filled):
        placed = _placed(lasers, ends, counts)
        boxes[filled, :2] = np.minimum(boxes[filled, :2], np.minimum.reduceat(placed, offsets[filled]))
        boxes[filled, 2:] = np.maximum(boxes[filled, 2:], np.maximum.reduceat(placed, offsets[filled]))
    return boxes


def _placed(lasers: Float, points: Float, counts: Int) -> Float:
    """Points of scans, (sum of counts, 2), in the map."""
    x, y, cos, sin = np.repeat(lasers, counts, axis=0).T
    px, py = points.T
    return np.stack((x + cos * px - sin * py, y + sin * px + cos * py), axis=1)


def _circles(points: Float, offsets: Int) -> tuple[Float, Int]:
    """Circles (x, y, radius) about every few neighbouring end points of a scan, (c, 3), and where each scan's begin."""
    size = _kernels.POINTS_A_CIRCLE
    counts = -(-np.diff(offsets) // size)
    circle_offsets = _offsets(counts)
    total = int(circle_offsets[-1])
    if not total:
        return np.zeros((0, 3)), circle_offsets
    number = np.arange(total) - np.repeat(circle_offsets[:-1], counts)
    begins = np.repeat(offsets[:-1], counts) + number * size
    low, high = np.minimum.reduceat(points, begins), np.maximum.reduceat(points, begins)
    centres = (low + high) / 2.0
    sizes = np.diff(np.append(begins, len(points)))
    away = np.hypot(*(points - np.repeat(centres, sizes, axis=0)).T)
    # A hair larger: rounding must never leave a point out.
    return np.column_stack((centres, np.maximum.reduceat(away, begins) * (1.0 + 1e-9) + 1e-9)), circle_offsets
