"""Visibility polygons: the free space that each scan has seen, MC section III.

A polygon runs through a scan's end points by bearing, and through the laser itself on the side that it does not see. It
is star-shaped about the laser, so the bearing of a point shows which side of the polygon is beyond it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.config import ConsistencyConfig
from mapmend.consistency import _kernels, _view_kernels
from mapmend.consistency.views import Beams, EndPoints, Polygons, ScanViews
from mapmend.errors import MapmendError
from mapmend.scan import LaserGeometry, Scans

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

FULL_TURN_GAP = 1.5
"""The beams cover a full turn if less than this many increments are between the last one and the first."""

EDGE_RAD, ROUNDING, NEAR = 1e-4, 5e-4, 0.02
"""Bounds of the rounding of points in float32: the errors of bearings and the relative errors of squared distances are
below these, for points farther from the laser than NEAR of the longest reach."""

SCANS_AT_ONCE = 2048
"""Polygons are made for this many scans at a time, which bounds the memory for intermediate results."""


def view_scans(scans: Scans, config: ConsistencyConfig) -> ScanViews:
    """What n scans saw, each in the frame of its laser; a scan without beams sees nothing.

    Readings up to ``config.max_range_m`` are end points; those beyond it count as free up to there. A beam without
    return, or with a reading that is too short, is ignored: there the polygon returns to the laser. Raises MapmendError
    for lasers whose beams are half a turn apart.
    """
    laser_of = scans.geometry_index.astype(np.int64)
    beams = _beams([_directions(geometry) for geometry in scans.geometries], laser_of)
    is_empty = np.diff(scans.offsets) == 0
    # After a scan's last vertex the first ones are repeated, so that each window of sides is contiguous.
    offsets = _offsets(np.where(is_empty, 0, beams.counts[laser_of] + _kernels.WINDOW))
    corners = np.zeros((5, int(offsets[-1])))
    ends, is_point = np.zeros((len(scans.ranges_m), 2)), np.zeros(len(scans.ranges_m), np.bool_)
    for k, geometry in enumerate(scans.geometries):
        rows = np.flatnonzero((laser_of == k) & ~is_empty)
        rays, count = _rays(geometry), int(beams.counts[k])
        around = np.arange(count + _kernels.WINDOW)
        for part in np.array_split(rows, -(-len(rows) // SCANS_AT_ONCE) or 1):
            readings = scans.offsets[part, None] + _beam_order(geometry)
            reach, returned = _reach(scans.ranges_m[readings], geometry, config)
            ends[readings], is_point[readings] = reach[:, :, None] * rays, returned
            vertices = np.zeros((len(part), count, 2))
            seen = min(count, geometry.beam_count)
            vertices[:, :seen] = ends[readings[:, :seen]]
            columns = offsets[part, None] + around
            for axis, values in enumerate(_sides(vertices)):
                corners[axis, columns] = values[:, around % max(count, 1)]
    point_offsets = np.concatenate(([0], np.cumsum(is_point)))[scans.offsets].astype(np.int64)
    return ScanViews(
        polygons=_polygons(corners, offsets, beams),
        points=_end_points(ends[is_point], point_offsets),
        beams=beams,
        ends=ends,
        end_offsets=scans.offsets,
        mountings=np.array([g.T_robot_laser for g in scans.geometries] or [(0.0, 0.0, 0.0)], dtype=np.float64),
    )


def _reach(ranges: NDArray[np.float32], geometry: LaserGeometry, config: ConsistencyConfig) -> tuple[Float, Bool]:
    """The free length of each beam, metres, 0 for an ignored beam, and whether it ends at a surface."""
    readings = ranges.astype(np.float64)
    with np.errstate(invalid="ignore"):
        seen = (readings >= config.min_range_m) & (readings < geometry.max_range_m)
    longest = config.max_range_m
    reach = np.where(seen, np.minimum(np.where(seen, readings, 0.0), longest), 0.0)
    return reach, seen & (readings <= longest)


def _sides(vertices: Float) -> tuple[Float, ...]:
    """Of vertices (scans, count, 2): x, y, the side to the next, and one over its squared length."""
    sides = np.roll(vertices, -1, axis=1) - vertices
    length2 = np.sum(sides**2, axis=2)
    inverse = np.divide(1.0, length2, out=np.zeros_like(length2), where=length2 > 0.0)
    return vertices[:, :, 0], vertices[:, :, 1], sides[:, :, 0], sides[:, :, 1], inverse


def _beam_order(geometry: LaserGeometry) -> Int:
    """A laser's beams from right to left."""
    rows = np.arange(geometry.beam_count, dtype=np.int64)
    return rows[::-1] if geometry.angle_increment_rad < 0.0 else rows


def _rays(geometry: LaserGeometry) -> Float:
    """Unit vectors of the beams from right to left, (beams, 2)."""
    bearings = geometry.bearings_rad()[_beam_order(geometry)]
    return np.stack((np.cos(bearings), np.sin(bearings)), axis=1)


def _beams(directions: list[Float], laser_of: Int) -> Beams:
    """``directions``: the bearings of each laser's vertices."""
    directions = directions or [np.zeros(0)]
    most = max(len(bearings) for bearings in directions)
    rays = np.zeros((len(directions), most, 2))
    wedges = np.zeros((len(directions), _kernels.SECTORS, 2), np.int32)
    for k, bearings in enumerate(directions):
        rays[k, : len(bearings)] = np.stack((np.cos(bearings), np.sin(bearings)), axis=1)
        if len(bearings):
            wedges[k] = _wedges(bearings, _sector_edges())
    counts = np.array([len(bearings) for bearings in directions], dtype=np.int64)
    passed = (wedges[:, :, 1] - wedges[:, :, 0]) % np.maximum(counts, 1)[:, None]
    return Beams(rays, wedges, passed.max(axis=1).astype(np.int64), counts, laser_of)


def _directions(geometry: LaserGeometry) -> Float:
    """The bearings of a polygon's vertices, sorted: its beams, and the middle of the blind side if there is one."""
    step = abs(geometry.angle_increment_rad)
    if step >= np.pi:
        raise MapmendError(f"a laser's beams lie {step:g} rad apart: no free space is known between them")
    if geometry.beam_count == 0:
        return np.zeros(0)
    # Beams beyond a full turn repeat the directions of the first ones.
    count = geometry.beam_count if step == 0.0 else min(geometry.beam_count, int(2.0 * np.pi / step - 1e-6) + 1)
    bearings = geometry.bearings_rad()[_beam_order(geometry)][:count]
    blind = 2.0 * np.pi - (count - 1) * step
    if count >= 3 and blind <= FULL_TURN_GAP * step:
        return bearings
    return np.append(bearings, bearings[-1] + blind / 2.0)


def _wedges(bearings: Float, angles: Float) -> NDArray[np.int32]:
    """The wedge between two neighbouring bearings, (count,), that contains each angle."""
    beyond_first = (angles - bearings[0]) % (2.0 * np.pi)
    return (np.searchsorted(bearings - bearings[0], beyond_first, side="right") - 1).astype(np.int32)


def _sector_edges() -> Float:
    """The two angles that bound each sector of the pseudo-angle, slightly widened: (SECTORS, 2)."""
    begins = _begins(_kernels.SECTORS)
    return np.stack((begins - EDGE_RAD, np.roll(begins, -1) + EDGE_RAD), axis=1)


def _begins(sectors: int) -> Float:
    """The angles at which sectors of the pseudo-angle begin, (sectors,)."""
    q = np.arange(sectors) * (4.0 / sectors) - 2.0
    y = np.where(np.abs(q) <= 1.0, q, np.sign(q) * 2.0 - q)
    x = np.where(np.abs(q) <= 1.0, 1.0, -1.0) * (1.0 - np.abs(y))
    return np.arctan2(y, x)


def _offsets(counts: Int) -> Int:
    return np.concatenate(([0], np.cumsum(counts))).astype(np.int64)


def _polygons(corners: Float, offsets: Int, beams: Beams) -> Polygons:
    """The polygons with these corners and offsets, and their limits."""
    n = len(beams.laser_of)
    edges = _sector_edges()
    rays = np.stack((np.cos(edges), np.sin(edges)), axis=2).reshape(-1, 4)
    reach2 = np.zeros((n, _kernels.SECTORS), np.float32)
    _view_kernels.sector_reach(corners, offsets, beams.counts, beams.laser_of, rays, beams.wedges, reach2)
    longest = float(np.sqrt(reach2.max(initial=0.0)))
    group_reach2 = np.zeros((n, _kernels.WIDE_SECTORS), np.float32)
    radius = _kernels.GROUP_RADIUS_M + ROUNDING * longest
    _view_kernels.group_reach(reach2, _gap_sines(_kernels.WIDE_SECTORS), radius, group_reach2)
    near2 = (NEAR * longest) ** 2
    sees = np.diff(offsets)[:, None] > 0

    def limits(squares: Single) -> Single:
        """The squared distances with room for rounding; 0 for scans without beams."""
        wider = np.maximum(squares * np.float32(1.0 + ROUNDING), np.float32(near2))
        return np.where(sees, wider, np.float32(0.0))

    return Polygons(corners, offsets, limits(reach2), limits(group_reach2), near2)


def _end_points(xy: Float, offsets: Int) -> EndPoints:
    """The end points (returns, 2) in groups."""
    middles, first_rows = np.empty((2, len(xy))), np.empty(len(xy) + 1, np.int64)
    counts = _view_kernels.group_points(xy, offsets, _kernels.GROUP, _kernels.GROUP_RADIUS_M, middles, first_rows)
    total = int(counts.sum())
    first_rows[total] = len(xy)
    return EndPoints(
        xy=xy,
        offsets=offsets,
        groups=middles[:, :total].astype(np.float32),
        group_rows=first_rows[: total + 1].copy(),
        group_offsets=_offsets(counts),
        coarse=np.ascontiguousarray(xy.T, dtype=np.float32),
    )


def _gap_sines(sectors: int) -> Float:
    """The sine of the angle between any two sectors of the pseudo-angle, 1 from a quarter turn on."""
    begin = _begins(sectors)
    ahead = (begin[None, :] - np.roll(begin, -1)[:, None]) % (2.0 * np.pi)
    gap = np.minimum(ahead, ahead.T)
    apart = np.abs(np.subtract.outer(np.arange(sectors), np.arange(sectors)))
    gap[np.minimum(apart, sectors - apart) <= 1] = 0.0
    return np.asarray(np.sin(np.clip(gap - 2.0 * EDGE_RAD, 0.0, np.pi / 2.0)))
