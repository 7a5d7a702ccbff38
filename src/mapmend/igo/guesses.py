"""Where matches start from between poses, and which poses and scores are the same."""

from __future__ import annotations

import numpy as np

from mapmend.geometry import se2
from mapmend.igo.observed import Float

# A pose that a match moves by less was right: what the front end, too, takes for no motion of the map.
SAME_M = 0.02
SAME_RAD = 0.007
# No slip carries a robot backwards by more.
BACKWARDS_M = 0.05
# Guesses between an edge and the optimizer: a false one may be metres off, and what lies that far is searched for.
MOST_GUESSES = 40


def between(first: Float, last: Float, every_m: float) -> list[Float]:
    """Poses (3,) every so many metres from the last to the first, the last aside; none where the two are near."""
    count = min(int(np.hypot(*(last - first)[:2]) / every_m), MOST_GUESSES)
    if count == 0:
        return []
    return [se2.interpolate(first, last, share) for share in np.linspace(1.0, 0.0, count + 1)[1:]]


def is_between(first: Float, last: Float, pose: Float, slack_m: float) -> bool:
    """Whether a pose (3,) lies on the way from one to another, or so little beyond: slip takes of a motion a part."""
    way, step = (last - first)[:2], (pose - first)[:2]
    length = float(np.hypot(way[0], way[1]))
    share = float(way @ step) / max(length, 1e-9)
    return -BACKWARDS_M <= share <= length + slack_m


def is_same(old: Float, new: Float) -> bool:
    """Whether an edge came back unchanged: two measurements (3,) of one motion."""
    off = se2.between(old, new)
    return bool(np.hypot(off[0], off[1]) <= SAME_M and abs(off[2]) <= SAME_RAD)


def score_noise(score: float, points: int) -> float:
    """The standard deviation of a score, a share of so many points: better by less is a tie."""
    return float(np.sqrt(max(score * (1.0 - score), 0.01) / max(points, 1)))
