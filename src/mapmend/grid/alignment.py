"""Straight maps: the direction in which most of a map's walls run, and the turn that lays it along the map's axes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import ScanConfig
from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose
from mapmend.scan import LaserGeometry, Scans

Float = NDArray[np.float64]

QUARTER = np.pi / 2.0
CHORD_RAD = np.radians(8.0)
"""The width of the wall stretches whose direction is measured: 0.4 m at 3 m, where 2 cm of noise turn it by 3
degrees."""

SHORTEST_CHORD_M = 0.2
NEAR_RAD = np.radians(3.0)
"""Walls within this of a direction count for it."""

LEAST_SHARE = 0.15
"""Walls with random directions have 2 * 3 / 90 = 0.07 of their length there. Twice that share is a main direction;
intel has 0.72."""

BINS = 360  # of a quarter turn
SCANS_AT_ONCE = 512


@dataclass(frozen=True)
class Alignment:
    """``T_map_start``: the pose of the robot's first frame in the aligned map, a turn by an eighth at most.

    ``wall_share``: the share of the length of straight walls that is then within 3 degrees of the axes. Below
    `LEAST_SHARE` there is no main direction, and nothing is turned.
    """

    T_map_start: tuple[float, float, float]
    wall_share: float

    @property
    def found(self) -> bool:
        return self.wall_share >= LEAST_SHARE


def align_walls(scans: Scans, poses: Float, config: ScanConfig) -> Alignment:
    """How to turn a map of n scans taken at ``poses``, (n, 3), so that most walls run along its axes.

    Walls at right angles to each other count as one direction. Raises MapmendError for other shapes.
    """
    if poses.shape != (len(scans), 3):
        raise MapmendError(f"{len(scans)} scans need poses of shape ({len(scans)}, 3), got {poses.shape}")
    parts = list(_chords(scans, poses, config)) or [np.zeros((0, 2))]
    chords = np.concatenate(parts)
    length = np.hypot(*chords.T)
    total = float(length.sum())
    if total == 0.0:
        return Alignment((0.0, 0.0, 0.0), 0.0)
    angle = np.arctan2(chords[:, 1], chords[:, 0])
    main = _refined(_most_common(angle, length), angle, length)
    share = float(length[np.abs(_off(angle, main)) <= NEAR_RAD].sum()) / total
    return Alignment((0.0, 0.0, -main if share >= LEAST_SHARE else 0.0), share)


def _off(angle: Float, direction: float) -> Float:
    """The differences of angles to a direction or the one at right angles to it, in [-45, 45) degrees."""
    return np.asarray((angle - direction + QUARTER / 2.0) % QUARTER - QUARTER / 2.0)


def _most_common(angle: Float, length: Float) -> float:
    """The middle of the widest 2 * NEAR_RAD of a quarter turn that holds the most length."""
    histogram, _ = np.histogram(angle % QUARTER, BINS, (0.0, QUARTER), weights=length)
    reach = round(NEAR_RAD / (QUARTER / BINS))
    around = sum(np.roll(histogram, step) for step in range(-reach, reach + 1))
    return (int(np.argmax(around)) + 0.5) * QUARTER / BINS


def _refined(direction: float, angle: Float, length: Float) -> float:
    """The mean of the directions near one, computed again around the result; in [-45, 45) degrees."""
    for _ in range(5):
        off = _off(angle, direction)
        near = np.abs(off) <= NEAR_RAD
        direction += float(np.average(off[near], weights=length[near])) if near.any() else 0.0
    return float(_off(np.array([direction]), 0.0)[0])


def _chords(scans: Scans, poses: Float, config: ScanConfig) -> Iterator[Float]:
    """Straight stretches of wall in the map, (k, 2) at a time: from the end of each beam to that of a beam farther
    on."""
    is_empty = np.diff(scans.offsets) == 0
    for number, geometry in enumerate(scans.geometries):
        rows = np.flatnonzero((scans.geometry_index == number) & ~is_empty)
        step = abs(geometry.angle_increment_rad)
        width = max(2, round(CHORD_RAD / step)) if step else geometry.beam_count
        if width >= geometry.beam_count:
            continue
        for part in np.array_split(rows, -(-len(rows) // SCANS_AT_ONCE) or 1):
            yield _straight(_ends(scans, part, poses, geometry, config), width, config.wall_std_m)


def _ends(scans: Scans, rows: NDArray[np.int64], poses: Float, geometry: LaserGeometry, config: ScanConfig) -> Float:
    """Beam ends in the map, (scans, beams, 2), nan for beams without a usable return."""
    ranges = scans.ranges_m[scans.offsets[rows, None] + np.arange(geometry.beam_count)].astype(np.float64)
    with np.errstate(invalid="ignore"):
        used = (ranges >= config.min_range_m) & (ranges <= min(config.max_range_m, geometry.max_range_m))
    laser = compose(poses[rows], np.array(geometry.T_robot_laser))
    bearings = laser[:, 2, None] + geometry.bearings_rad()
    reach = np.where(used, ranges, np.nan)
    return laser[:, None, :2] + reach[:, :, None] * np.stack((np.cos(bearings), np.sin(bearings)), axis=2)


def _straight(ends: Float, width: int, wall_std_m: float) -> Float:
    """The chords over ``width`` beams for which all ends in between are within ``wall_std_m``: (k, 2)."""
    chord = ends[:, width:] - ends[:, :-width]
    length = np.hypot(chord[..., 0], chord[..., 1])
    is_wall = length >= SHORTEST_CHORD_M
    for k in range(1, width):
        inner = ends[:, k : k - width] - ends[:, :-width]
        off = np.abs(chord[..., 0] * inner[..., 1] - chord[..., 1] * inner[..., 0])
        is_wall &= off <= wall_std_m * length
    return np.asarray(chord[is_wall])
