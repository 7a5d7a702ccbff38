"""Poses of a trajectory at times between its stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array, interpolate


def checked_trajectory(stamps_s: ArrayLike, poses: ArrayLike, name: str) -> tuple[Array, Array]:
    """The two as float64 arrays of shapes (n,) and (n, 3).

    Raises MapmendError if the shapes differ from these, if n is 0 or if a number is not finite.
    """
    stamps, rows = np.asarray(stamps_s, dtype=np.float64), np.asarray(poses, dtype=np.float64)
    if stamps.ndim != 1 or rows.shape != (len(stamps), 3):
        raise MapmendError(f"{name} needs stamps (n,) and poses (n, 3), got {stamps.shape} and {rows.shape}")
    if not len(stamps):
        raise MapmendError(f"{name} has no poses")
    if not (np.all(np.isfinite(stamps)) and np.all(np.isfinite(rows))):
        raise MapmendError(f"{name} has stamps or poses that are not finite")
    return stamps, rows


@dataclass(frozen=True)
class StampedPoses:
    """A trajectory as a function of time: strictly rising stamps, shape (n,), and poses, shape (n, 3)."""

    stamps_s: Array
    poses: Array

    @staticmethod
    def of(stamps_s: ArrayLike, poses: ArrayLike, name: str = "the trajectory") -> StampedPoses:
        """Sorted by stamp (rows of equal stamps keep their order), the first row of each repeated stamp.

        Raises MapmendError as ``checked_trajectory`` does.
        """
        stamps, rows = checked_trajectory(stamps_s, poses, name)
        order = np.argsort(stamps, kind="stable")
        stamps, rows = stamps[order], rows[order]
        is_first = np.concatenate(([True], np.diff(stamps) > 0.0))
        return StampedPoses(stamps[is_first], rows[is_first])

    def at(self, times_s: ArrayLike) -> tuple[Array, Array]:
        """Poses at the given times, shape (m, 3), and each time's distance from the nearest stamp, seconds, (m,).

        Between two stamps x, y and the angle are linear in time, the angle along the shorter turn. Before the first
        stamp and after the last, the pose there is used; a caller can detect this by the distance.
        """
        times = np.asarray(times_s, dtype=np.float64)
        last = len(self.stamps_s) - 1
        after = np.clip(np.searchsorted(self.stamps_s, times), min(1, last), last)
        before = np.maximum(after - 1, 0)
        since, until = times - self.stamps_s[before], self.stamps_s[after] - times
        span = np.where(after > before, self.stamps_s[after] - self.stamps_s[before], 1.0)
        share = np.clip(since / span, 0.0, 1.0)
        poses = interpolate(self.poses[before], self.poses[after], share)
        return poses, np.minimum(np.abs(since), np.abs(until))
