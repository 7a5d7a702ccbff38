"""Odometry at the times of the scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry.se2 import interpolate

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class OdometrySeries:
    """Poses ``T_odometry_robot``, shape (m, 3), at ``stamps_ns``, shape (m,), which rise or repeat."""

    stamps_ns: Int
    poses: Float

    @classmethod
    def sorted(cls, stamps_ns: Int, poses: Float) -> OdometrySeries:
        """In the order of the stamps; among equal ones, in the order of recording."""
        order = np.argsort(stamps_ns, kind="stable")
        return cls(stamps_ns[order], poses[order])

    def at(self, stamps_ns: Int) -> Float:
        """The poses at the given times, shape (k, 3): interpolated, and constant before the first and after the
        last."""
        after = np.clip(np.searchsorted(self.stamps_ns, stamps_ns, side="right"), 1, max(len(self.stamps_ns) - 1, 1))
        before = np.minimum(after - 1, len(self.stamps_ns) - 1)
        after = np.minimum(after, len(self.stamps_ns) - 1)
        gap = np.maximum(self.stamps_ns[after] - self.stamps_ns[before], 1)
        share = np.clip((stamps_ns - self.stamps_ns[before]) / gap, 0.0, 1.0)
        return interpolate(self.poses[before], self.poses[after], share)

    def at_scans(self, stamps_ns: Int) -> Float:
        """The same for scans in the order of recording: a message with exactly the scan's stamp is its odometry.

        The k-th of the scans with one stamp takes the k-th message of that stamp: clocks may repeat a stamp, and
        interpolation would give all of these scans the same pose.
        """
        poses = self.at(stamps_ns)
        first = np.searchsorted(self.stamps_ns, stamps_ns, side="left")
        messages = np.searchsorted(self.stamps_ns, stamps_ns, side="right") - first
        own = messages > 0
        rank = np.minimum(_rank_among_equals(stamps_ns), messages - 1)
        poses[own] = self.poses[(first + rank)[own]]
        return poses

    def outside_s(self, stamps_ns: Int) -> Float:
        """How far each time is before the first or after the last message, in seconds, shape (k,)."""
        early, late = self.stamps_ns[0] - stamps_ns, stamps_ns - self.stamps_ns[-1]
        return np.maximum(np.maximum(early, late), 0) * 1e-9


def _rank_among_equals(values: Int) -> Int:
    """How many equal values come before each, shape (k,)."""
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    starts = np.searchsorted(ordered, ordered, side="left")
    rank = np.empty(len(values), np.int64)
    rank[order] = np.arange(len(values)) - starts
    return rank
