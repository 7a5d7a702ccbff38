"""Poses over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry.se2 import between

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Poses over time: ``stamps_s`` shape (n,), ``poses`` shape (n, 3), in the order in which they were given."""

    stamps_s: Float
    poses: Float

    def __len__(self) -> int:
        return len(self.stamps_s)


def path_length_m(poses: Float) -> float:
    """The length of the path through poses of shape (n, 3)."""
    step = between(poses[:-1], poses[1:])
    return float(np.hypot(step[:, 0], step[:, 1]).sum())
