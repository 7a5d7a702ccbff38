"""How a robot drives a route, and what its wheels report while they slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array, compose, wrap_angle

SHARPEST_ARC_RAD = np.radians(150.0)
"""A turn sharper than this is made on the spot."""


@dataclass(frozen=True)
class SlipEvent:
    """From ``start_m`` along the route, the wheels report ``length_m`` of which ``share`` does not happen.

    The robot moves by ``(1 - share) * length_m`` in that time: 0.3 is a slippery floor, 1 spins on the spot. A negative
    share is a skid: the robot goes further than its wheels report. Turning on the spot never slips.
    Raises MapmendError for a share above 1, a length that is not positive, a start before 0.
    """

    start_m: float
    length_m: float
    share: float

    def __post_init__(self) -> None:
        if not (0.0 <= self.start_m < np.inf and 0.0 < self.length_m < np.inf and -np.inf < self.share <= 1.0):
            raise MapmendError(f"a slip needs start_m >= 0, length_m > 0 and share <= 1, got {self}")

    @property
    def end_m(self) -> float:
        """Its end on the route."""
        return self.start_m + (1.0 - self.share) * self.length_m


@dataclass(frozen=True)
class Traction:
    """The path that the wheels report over the path on the ground: a line through knots, both of shape (k,), never
    falling.

    Beyond the last knot both grow equally.
    """

    path_m: Array
    wheel_m: Array

    @staticmethod
    def with_slips(slips: Sequence[SlipEvent]) -> Traction:
        """Raises MapmendError if two of the slips overlap."""
        path, wheel = [0.0], [0.0]
        for slip in sorted(slips, key=lambda s: s.start_m):
            if slip.start_m < path[-1] - 1e-9:
                raise MapmendError(f"the slip from {slip.start_m:.3f} m begins before the one before it has ended")
            wheel_start = wheel[-1] + slip.start_m - path[-1]
            path += [slip.start_m, slip.end_m]
            wheel += [wheel_start, wheel_start + slip.length_m]
        return Traction(np.array(path), np.array(wheel))

    def reported_m(self, path_m: ArrayLike) -> Array:
        """The path that the wheels report when the robot has driven ``path_m``."""
        way = np.asarray(path_m, dtype=np.float64)
        return np.interp(way, self.path_m, self.wheel_m) + np.maximum(way - self.path_m[-1], 0.0)

    def travelled_m(self, wheel_m: ArrayLike) -> Array:
        """The path that the robot has driven when the wheels report ``wheel_m``."""
        reported = np.asarray(wheel_m, dtype=np.float64)
        return np.interp(reported, self.wheel_m, self.path_m) + np.maximum(reported - self.wheel_m[-1], 0.0)


@dataclass(frozen=True)
class Drive:
    """k motions one after the other, each along an arc: ``lengths_m`` and ``angles_rad``, shape (k,).

    ``start_poses``: shape (k, 3). ``starts_s``, ``paths_m`` and ``wheels_m``: shape (k + 1,), time, path on the ground
    and path reported at the motions' starts and at the end of the last. ``traction`` relates the last two.
    """

    start_poses: Array
    lengths_m: Array
    angles_rad: Array
    starts_s: Array
    paths_m: Array
    wheels_m: Array
    traction: Traction

    @property
    def duration_s(self) -> float:
        return float(self.starts_s[-1])

    def at(self, times_s: ArrayLike) -> tuple[Array, Array, Array]:
        """True poses (m, 3), path on the ground (m,) and path that the wheels report (m,) at times of shape (m,)."""
        times = np.asarray(times_s, dtype=np.float64)
        k = np.clip(np.searchsorted(self.starts_s, times, side="right") - 1, 0, len(self.lengths_m) - 1)
        span_s = np.maximum(self.starts_s[k + 1] - self.starts_s[k], 1e-300)
        time_share = np.clip((times - self.starts_s[k]) / span_s, 0.0, 1.0)
        wheel_m = self.wheels_m[k] + time_share * (self.wheels_m[k + 1] - self.wheels_m[k])
        path_m = np.clip(self.traction.travelled_m(wheel_m), self.paths_m[k], self.paths_m[k + 1])
        moves = self.lengths_m[k] > 0.0
        path_share = (path_m - self.paths_m[k]) / np.where(moves, self.lengths_m[k], 1.0)
        share = np.where(moves, path_share, time_share)
        step = arc_step(self.lengths_m[k] * share, self.angles_rad[k] * share)
        return compose(self.start_poses[k], step), path_m, wheel_m


def arc_step(length_m: Array, angle_rad: Array) -> Array:
    """The motion along arcs of the given lengths that turn by the given angles, shape (..., 3)."""
    half = angle_rad / 2.0
    chord = length_m * np.sinc(half / np.pi)
    return np.stack((chord * np.cos(half), chord * np.sin(half), angle_rad), axis=-1)


def plan_drive(
    route: Array, speed_mps: float, turn_rate_radps: float, turn_radius_m: float, slips: Sequence[SlipEvent] = ()
) -> Drive:
    """Straight from way-point to way-point of a route (k, 2); corners are cut by arcs or turned on the spot.

    An arc needs legs that are long enough and a turn below 150 degrees; with ``turn_radius_m`` 0, all turns are on the
    spot. The wheels
    turn at ``speed_mps`` whether they slip or not; a turn takes at least what ``turn_rate_radps`` allows.
    Raises MapmendError for speeds that are not positive, way-points that coincide, or slips that overlap or
    begin after the end.
    """
    if not (speed_mps > 0.0 and turn_rate_radps > 0.0 and turn_radius_m >= 0.0):
        raise MapmendError(f"speeds must be positive, got {speed_mps} m/s, {turn_rate_radps} rad/s, {turn_radius_m} m")
    lengths, angles, first_pose = _motions(route, turn_radius_m)
    steps = arc_step(lengths, angles)
    poses = [first_pose]
    for step in steps:
        poses.append(compose(poses[-1], step))
    traction = Traction.with_slips(slips)
    paths = np.concatenate(([0.0], np.cumsum(lengths)))
    if any(slip.start_m >= paths[-1] for slip in slips):
        raise MapmendError(f"a slip begins after the end of the drive, which is {paths[-1]:.3f} m long")
    wheels = traction.reported_m(paths)
    durations = np.maximum(np.diff(wheels) / speed_mps, np.abs(angles) / turn_rate_radps)
    starts = np.concatenate(([0.0], np.cumsum(durations)))
    return Drive(np.array(poses[:-1]), lengths, angles, starts, paths, wheels, traction)


def straight_stretches(drive: Drive) -> Array:
    """The straight parts of the drive: shape (s, 2), from and to in metres along the path."""
    is_straight = (drive.angles_rad == 0.0) & (drive.lengths_m > 0.0)
    return np.column_stack((drive.paths_m[:-1], drive.paths_m[1:]))[is_straight]


def _motions(route: Array, turn_radius_m: float) -> tuple[Array, Array, Array]:
    """Lengths and angles of alternating straight runs and turns, and the first pose."""
    legs = np.diff(route, axis=0)
    leg_lengths = np.hypot(legs[:, 0], legs[:, 1])
    if np.any(leg_lengths < 1e-6):
        raise MapmendError(f"way-points {int(np.argmin(leg_lengths))} and the next of the route coincide")
    headings = np.arctan2(legs[:, 1], legs[:, 0])
    turns = wrap_angle(np.diff(headings))
    size = np.minimum(np.abs(turns), SHARPEST_ARC_RAD)
    tangents = turn_radius_m * np.tan(size / 2.0)
    fits = (np.abs(turns) <= SHARPEST_ARC_RAD) & (tangents <= 0.45 * np.minimum(leg_lengths[:-1], leg_lengths[1:]))
    cut = np.where(fits, tangents, 0.0)
    straight = leg_lengths - np.concatenate(([0.0], cut)) - np.concatenate((cut, [0.0]))
    lengths, angles = np.zeros(2 * len(legs) - 1), np.zeros(2 * len(legs) - 1)
    lengths[0::2] = straight
    lengths[1::2] = np.where(fits, turn_radius_m * np.abs(turns), 0.0)
    angles[1::2] = turns
    return lengths, angles, np.array([route[0, 0], route[0, 1], headings[0]])
