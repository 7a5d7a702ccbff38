"""Laser scans and logs of them, and the checks that reject bad scans."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmend.errors import MapmendError

Float = NDArray[np.float64]

_BLOCK = 1 << 20  # readings


@dataclass(frozen=True)
class LaserGeometry:
    """The beams of a laser: beam k has the direction ``first_angle_rad + k * angle_increment_rad``.

    A reading at or above ``max_range_m`` is no return. ``T_robot_laser`` is the laser's pose on the robot.
    """

    beam_count: int
    first_angle_rad: float
    angle_increment_rad: float
    max_range_m: float
    T_robot_laser: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (self.first_angle_rad, self.angle_increment_rad, *self.T_robot_laser)
        if not np.all(np.isfinite(numbers)):
            raise MapmendError(f"laser geometry must be finite, got {numbers}")
        if not self.max_range_m > 0.0:
            raise MapmendError(f"max_range_m must be positive, got {self.max_range_m}")
        if self.beam_count < 0:
            raise MapmendError(f"beam_count must not be negative, got {self.beam_count}")

    def bearings_rad(self) -> Float:
        """The beams' directions in the laser's frame, shape (beam_count,)."""
        return self.first_angle_rad + self.angle_increment_rad * np.arange(self.beam_count, dtype=np.float64)


@dataclass(frozen=True)
class Scans:
    """n scans of any beam counts, one after the other in one array.

    ``ranges_m``: float32, shape (total,), metres; ``inf`` for no return, ``nan`` for an unusable reading.
    ``offsets``: int64, shape (n + 1,), scan k is ``ranges_m[offsets[k]:offsets[k + 1]]``, empty for "none".
    ``geometry_index``: int32, shape (n,), into ``geometries``.
    """

    ranges_m: NDArray[np.float32]
    offsets: NDArray[np.int64]
    geometry_index: NDArray[np.int32]
    geometries: tuple[LaserGeometry, ...]

    def __post_init__(self) -> None:
        n = len(self.geometry_index)
        if self.offsets.shape != (n + 1,):
            raise MapmendError(f"offsets must have shape ({n + 1},), got {self.offsets.shape}")
        if self.offsets[0] != 0 or self.offsets[-1] != len(self.ranges_m) or np.any(np.diff(self.offsets) < 0):
            raise MapmendError("offsets must rise from 0 to the number of ranges")
        if n and (self.geometry_index.min() < 0 or self.geometry_index.max() >= max(len(self.geometries), 1)):
            raise MapmendError("geometry_index points outside geometries")
        counts = np.diff(self.offsets)
        expected = np.array([g.beam_count for g in self.geometries] or [0])[self.geometry_index]
        if np.any((counts != expected) & (counts != 0)):
            k = int(np.argmax((counts != expected) & (counts != 0)))
            raise MapmendError(f"scan {k} has {counts[k]} beams where its laser has {expected[k]}")
        with np.errstate(invalid="ignore"):
            if np.any(self.ranges_m <= 0.0):
                raise MapmendError("ranges must be positive, inf (no return) or nan (unusable)")

    def __len__(self) -> int:
        return len(self.geometry_index)

    def ranges_of(self, k: int) -> NDArray[np.float32]:
        """The readings of scan k, shape (beams,), a view."""
        return self.ranges_m[self.offsets[k] : self.offsets[k + 1]]

    def laser_of(self, k: int) -> int:
        """The geometry of scan k."""
        return int(self.geometry_index[k])

    def replace_ranges_of(self, k: int, ranges_m: NDArray[np.float32]) -> None:
        """Replaces the readings of scan k by the same number of others."""
        self.ranges_of(k)[:] = ranges_m

    def blocks(self) -> Iterator[NDArray[np.float32]]:
        """All readings, some megabytes at a time."""
        for begin in range(0, len(self.ranges_m), _BLOCK):
            yield self.ranges_m[begin : begin + _BLOCK]

    def geometry_of(self, k: int) -> LaserGeometry:
        return self.geometries[self.geometry_index[k]]

    def select(self, rows: NDArray[np.int64]) -> Scans:
        """The scans of the given rows, in that order."""
        counts = np.diff(self.offsets)[rows]
        offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
        parts = [self.ranges_of(int(k)) for k in rows]
        ranges = np.concatenate(parts) if parts else np.zeros(0, np.float32)
        return Scans(ranges, offsets, self.geometry_index[rows], self.geometries)


def checked_ranges(ranges_m: ArrayLike, geometry: LaserGeometry) -> NDArray[np.float32]:
    """The readings of one scan as float32, shape (beams,); raises MapmendError if they are not of that laser."""
    ranges = np.asarray(ranges_m, dtype=np.float32)
    if ranges.shape != (geometry.beam_count,):
        raise MapmendError(f"ranges_m must have shape ({geometry.beam_count},), got {ranges.shape}")
    with np.errstate(invalid="ignore"):
        if np.any(ranges <= 0.0):
            raise MapmendError("ranges must be positive, inf (no return) or nan (unusable)")
    return ranges


def scans_of(ranges_m: ArrayLike, geometry: LaserGeometry) -> Scans:
    """Scans of one laser from an array, shape (n, beams); raises MapmendError naming the scan and the beam."""
    try:
        ranges = np.asarray(ranges_m, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise MapmendError(f"ranges_m must be numbers, as many in each scan ({error})") from None
    if ranges.ndim != 2 or ranges.shape[1] != geometry.beam_count:
        raise MapmendError(f"ranges_m must have shape (n, {geometry.beam_count}), got {ranges.shape}")
    with np.errstate(invalid="ignore"):
        wrong = np.argwhere(ranges <= 0.0)
    if len(wrong):
        (k, beam), what = wrong[0].tolist(), "a range is positive, inf (no return) or nan (unusable)"
        raise MapmendError(f"scan {k}, beam {beam}: {ranges[k, beam]:g}; {what}")
    n, beams = ranges.shape
    offsets = np.arange(n + 1, dtype=np.int64) * beams
    return Scans(ranges.ravel(), offsets, np.zeros(n, np.int32), (geometry,))


def geometry_of_angles(angles_rad: ArrayLike, max_range_m: float) -> LaserGeometry:
    """The laser whose beams have the angles, shape (beams,); raises MapmendError unless they are evenly spaced."""
    angles = np.asarray(angles_rad, dtype=np.float64)
    if angles.ndim != 1 or len(angles) < 2 or not np.all(np.isfinite(angles)):
        raise MapmendError(f"angles must be finite, of shape (beams,), with two beams at least; got {angles.shape}")
    step = float(angles[-1] - angles[0]) / (len(angles) - 1)
    geometry = LaserGeometry(len(angles), float(angles[0]), step, max_range_m)
    off = np.abs(angles - geometry.bearings_rad())
    # Angles in whole thousandths of a degree or in single precision are as even as they can be.
    if step == 0.0 or off.max() > max(0.02 * abs(step), 2e-5):
        k = int(np.argmax(off))
        raise MapmendError(f"angles must be evenly spaced; beam {k} is {off[k]:.2g} rad off a step of {step:.4g} rad")
    return geometry


@dataclass(frozen=True)
class Note:
    """Something odd about a file that could still be read: what, how often, and in which line first."""

    what: str
    count: int = 1
    first_line: int | None = None

    def __str__(self) -> str:
        times = "" if self.count == 1 else f" ({self.count} times)"
        where = "" if self.first_line is None else f", first in line {self.first_line}"
        return f"{self.what}{times}{where}"


@dataclass(frozen=True)
class ScanLog:
    """A recording: one row for each scan, in the order of recording.

    ``stamps_s``: shape (n,), seconds; the row number if the log has no usable stamps (``has_stamps`` False).
    ``odometry``: shape (n, 3), ``T_odometry_robot`` at each scan, zero if there is none (``has_odometry`` False).
    ``notes`` describe what was odd.
    """

    scans: Scans
    stamps_s: Float
    odometry: Float
    has_stamps: bool = True
    source: str = ""
    notes: tuple[Note, ...] = field(default=())
    has_odometry: bool = True

    def __post_init__(self) -> None:
        n = len(self.scans)
        if self.stamps_s.shape != (n,):
            raise MapmendError(f"stamps_s must have shape ({n},), got {self.stamps_s.shape}")
        if self.odometry.shape != (n, 3):
            raise MapmendError(f"odometry must have shape ({n}, 3), got {self.odometry.shape}")
        if not (np.all(np.isfinite(self.stamps_s)) and np.all(np.isfinite(self.odometry))):
            raise MapmendError("stamps and odometry must be finite")

    @classmethod
    def from_arrays(
        cls,
        ranges_m: ArrayLike,
        *,
        geometry: LaserGeometry | None = None,
        angles_rad: ArrayLike | None = None,
        max_range_m: float | None = None,
        stamps_s: ArrayLike | None = None,
        odometry: ArrayLike | None = None,
    ) -> ScanLog:
        """A log of n scans by one laser.

        ``ranges_m``: (n, beams), metres; inf for no return, nan for an unusable reading. The laser: its ``geometry``,
        or the beams' evenly spaced ``angles_rad`` (beams,) in the robot's frame with the laser's ``max_range_m``.
        ``stamps_s``: (n,), seconds, not falling; None if there are none. ``odometry``: (n, 3), poses of the robot
        (metres, radians); None if there is none: such a log is mapped from the laser alone.

        Raises MapmendError for other shapes, for ranges that are not positive, for numbers that are not finite, for
        stamps that fall, and unless the laser is given in one of the two ways.
        """
        if (geometry is None) == (angles_rad is None):
            raise MapmendError("give either geometry or angles_rad")
        if geometry is None:
            if angles_rad is None or max_range_m is None:
                raise MapmendError("angles_rad needs max_range_m, from which on a reading is no return")
            geometry = geometry_of_angles(angles_rad, max_range_m)
        elif max_range_m is not None:
            raise MapmendError("the geometry says max_range_m; leave it out")
        scans = scans_of(ranges_m, geometry)
        n = len(scans)
        stamps = np.arange(n, dtype=np.float64) if stamps_s is None else np.array(stamps_s, dtype=np.float64)
        poses = np.zeros((n, 3)) if odometry is None else np.array(odometry, dtype=np.float64)
        log = cls(scans, stamps, poses, has_stamps=stamps_s is not None, has_odometry=odometry is not None)
        falls = np.flatnonzero(np.diff(log.stamps_s) < 0.0)
        if len(falls):
            k = int(falls[0]) + 1
            raise MapmendError(f"stamps_s must not fall; that of scan {k} is {stamps[k]:g} after {stamps[k - 1]:g}")
        return log

    def __len__(self) -> int:
        return len(self.scans)

    @property
    def odometry_moves(self) -> bool:
        """Whether the odometry reports any motion at all; a log without odometry has the same pose throughout."""
        return bool(len(self) and np.any(self.odometry != self.odometry[0]))
