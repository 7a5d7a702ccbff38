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

    def __len__(self) -> int:
        return len(self.scans)

    @property
    def odometry_moves(self) -> bool:
        """Whether the odometry reports any motion at all; a log without odometry has the same pose throughout."""
        return bool(len(self) and np.any(self.odometry != self.odometry[0]))
