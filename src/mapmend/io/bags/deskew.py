"""De-skewing: the sweeps of a moving robot as they would look from the pose at the beginning of each sweep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry.se2 import between, compose, inverse, transform_points
from mapmend.io.bags.frames import Mounting
from mapmend.io.bags.odometry import OdometrySeries
from mapmend.io.bags.sweeps import Laser, double_angle
from mapmend.scan import LaserGeometry, Note, Scans

Float = NDArray[np.float64]
Int = NDArray[np.int64]

_LEAST_M, _LEAST_RAD = 5e-4, 1e-4  # less motion within a sweep moves readings by less than their noise
_SURFACE_GAP = 0.1  # neighbours that differ by more than this share of the range are two surfaces
_LONGEST_SWEEP_S = 2.0


def deskewed(
    scans: Scans,
    lasers: list[tuple[Laser, Mounting]],
    stamps_ns: Int,
    series: OdometrySeries | None,
    notes: list[Note],
) -> Scans:
    """The scans from the robot's pose at their stamps, the time of their first beam; with the same geometry.

    ``lasers``, one for each geometry, give the time between beams. Within a sweep the motion is even. Changes
    ``scans.ranges_m`` in place; notes say how many sweeps were de-skewed, or why none was.
    """
    if series is None:
        notes.append(Note("sweeps can't be de-skewed without odometry"))
        return scans
    durations_s = np.array([_duration_s(laser) for laser, _ in lasers])[scans.geometry_index]
    if not durations_s.any():
        notes.append(Note("sweeps can't be de-skewed: the scans have no time_increment"))
        return scans
    ends_ns = stamps_ns + np.rint(durations_s * 1e9).astype(np.int64)
    motion = between(series.at(stamps_ns), series.at(ends_ns))
    moved = (np.hypot(motion[:, 0], motion[:, 1]) > _LEAST_M) | (np.abs(motion[:, 2]) > _LEAST_RAD)
    backwards = [_runs_clockwise(laser, mounting) for laser, mounting in lasers]
    bearings = [geometry.bearings_rad() for geometry in scans.geometries]
    for k in np.flatnonzero(moved & (durations_s > 0.0)).tolist():
        which = int(scans.geometry_index[k])
        geometry, readings = scans.geometries[which], scans.ranges_of(k)
        straight = _straight(readings, bearings[which], geometry, motion[k], backwards[which])
        scans.replace_ranges_of(k, straight)
    notes.append(Note("sweep de-skewed", int(np.count_nonzero(moved & (durations_s > 0.0)))))
    return scans


def _duration_s(laser: Laser) -> float:
    """The time from the first beam to the last; 0 if the message does not give it."""
    duration = abs(laser.time_increment_s) * max(laser.beams - 1, 0)
    return duration if 0.0 < duration < _LONGEST_SWEEP_S else 0.0


def _runs_clockwise(laser: Laser, mounting: Mounting) -> bool:
    """Whether the beams were measured in the opposite of their present order."""
    return (double_angle(laser.angle_increment_rad) < 0.0) != mounting.upside_down


def _straight(
    readings: NDArray[np.float32], bearings: Float, geometry: LaserGeometry, motion: Float, backwards: bool
) -> NDArray[np.float32]:
    """One sweep; ``motion``: the robot's pose at the last beam relative to that at the first."""
    share = np.linspace(0.0, 1.0, len(readings))
    share = share[::-1] if backwards else share
    mounting = np.array(geometry.T_robot_laser)
    # The laser's pose at each beam, relative to that at the first.
    T_laser = compose(inverse(mounting), compose(share[:, None] * motion, mounting))
    seen = np.isfinite(readings)
    directions: Float = bearings + T_laser[:, 2]
    distances = readings.astype(np.float64)
    beams = np.column_stack((readings * np.cos(bearings), readings * np.sin(bearings)))[seen]
    points = transform_points(T_laser[seen], beams[:, None, :])[:, 0, :]
    distances[seen] = np.hypot(points[:, 0], points[:, 1])
    turn = np.arctan2(points[:, 1], points[:, 0]) - bearings[seen]
    directions[seen] = bearings[seen] + (turn + np.pi) % (2.0 * np.pi) - np.pi
    return _resampled(directions, distances, bearings, geometry.angle_increment_rad)


def _resampled(directions: Float, distances: Float, bearings: Float, increment: float) -> NDArray[np.float32]:
    """Distances along ``bearings``: to the segment between two neighbours on one surface, otherwise that of the
    nearer."""
    order = np.argsort(directions, kind="stable")
    directions, distances = directions[order], distances[order]
    right = np.clip(np.searchsorted(directions, bearings), 1, len(directions) - 1)
    left = right - 1
    a, b = distances[left], distances[right]
    before, after = bearings - directions[left], directions[right] - bearings
    result = np.where(np.abs(before) <= np.abs(after), a, b)
    with np.errstate(invalid="ignore"):
        one_surface = np.abs(a - b) <= _SURFACE_GAP * np.minimum(a, b)  # false for beams without a return
        inside = one_surface & (before >= 0.0) & (after >= 0.0) & (before + after > 1e-9)
        # Where the beam crosses the segment: the triangle's area is the sum of its two parts.
        area = a * np.sin(before) + b * np.sin(after)
        crossing = a * b * np.sin(before + after) / np.where(inside, area, 1.0)
    result = np.where(inside, crossing, result)
    unseen = np.minimum(np.abs(before), np.abs(after)) > 1.5 * abs(increment)
    return np.where(unseen, np.nan, result).astype(np.float32)
