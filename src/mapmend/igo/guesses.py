"""Guesses between poses from which matches start, and when two poses or scores count as the same."""

from __future__ import annotations

import numpy as np

from mapmend.config import IgoConfig
from mapmend.geometry import se2
from mapmend.igo.observed import Float

# No slip moves a robot backwards by more than this.
BACKWARDS_M = 0.05
# The greatest number of guesses between an edge and the optimizer: a false edge may be metres off.
MOST_GUESSES = 40


def between(first: Float, last: Float, every_m: float) -> list[Float]:
    """Poses (3,) at equal distances from the last to the first, without the last; none if the two are near."""
    count = min(int(np.hypot(*(last - first)[:2]) / every_m), MOST_GUESSES)
    if count == 0:
        return []
    return [se2.interpolate(first, last, share) for share in np.linspace(1.0, 0.0, count + 1)[1:]]


def is_between(first: Float, last: Float, pose: Float, slack_m: float) -> bool:
    """Whether a pose (3,) is on the line from one to another, or only slightly beyond: slip removes a part of a
    motion."""
    way, step = (last - first)[:2], (pose - first)[:2]
    length = float(np.hypot(way[0], way[1]))
    share = float(way @ step) / max(length, 1e-9)
    return -BACKWARDS_M <= share <= length + slack_m


def is_same(old: Float, new: Float, settings: IgoConfig) -> bool:
    """Whether two measurements (3,) of one motion are the same, so that the edge is unchanged."""
    off = se2.between(old, new)
    return bool(np.hypot(off[0], off[1]) <= settings.same_m and abs(off[2]) <= settings.same_rad)


def score_noise(score: float, points: int) -> float:
    """The standard deviation of a score, which is a share of this many points: smaller gains are ties."""
    return float(np.sqrt(max(score * (1.0 - score), 0.01) / max(points, 1)))
