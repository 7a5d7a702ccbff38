"""How plausible the odometry's steps are, given the robot's speed in the rest of the log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

MOVING_M, MOVING_RAD = 0.01, 0.005
"""Smaller steps are the noise of a robot that stands, or that drives straight on."""

FAST_QUANTILE = 0.95
"""A fast step is this quantile of the steps of the moving robot. Jumps in fewer than 5 % of them hardly change it."""

ODD_OVER_FAST, MOST_OVER_FAST = 2.0, 4.0
"""A step longer than 2 fast ones is odd, and one longer than 4 did not happen. Over 1, 3 and 7 scans of
intel, fr079, fr-clinic and ual, which have no jumps, the longest translation has 1.05 to 3.3 fast ones; the longest
turn has 1.3 to 2.8, and 5.6 over 7 scans of fr-clinic, which hardly turns."""

FEWEST_STEPS = 20
"""With fewer moving steps, the speed of the robot is unknown."""


@dataclass(frozen=True)
class PlausibleSteps:
    """``fast`` (2,): translation (m) and turn (rad) of a fast step; ``plausibility`` (n,): 1 for a usual step, 0 for
    one that did not happen.

    Row k is the step from scan k to k + 1. If the robot moves too rarely to know its speed, every step is plausible,
    and ``fast`` is the largest.
    """

    fast: Float
    plausibility: Float


def plausible_steps(steps: Float, stamps_s: Float) -> PlausibleSteps:
    """Judges the odometry's ``steps`` (n, 3) between scans at ``stamps_s`` (n + 1,).

    A longer pause between two stamps makes a longer step plausible. A shorter pause makes no step implausible, because
    stamps jitter, step back and repeat in real logs.
    """
    size = np.column_stack((np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])))
    pause_s = np.diff(stamps_s)
    usual_s = float(np.median(pause_s)) if len(pause_s) else 0.0
    longer = np.maximum(pause_s / usual_s, 1.0) if usual_s > 0.0 else np.ones(len(steps))
    fast = np.empty(2)
    for axis, least in enumerate((MOVING_M, MOVING_RAD)):
        moving = size[size[:, axis] > least, axis]
        known = len(moving) >= FEWEST_STEPS
        fast[axis] = np.quantile(moving, FAST_QUANTILE) if known else max(size[:, axis].max(initial=0.0), least)
    over = (size / fast).max(axis=1) / longer
    return PlausibleSteps(fast, np.clip((MOST_OVER_FAST - over) / (MOST_OVER_FAST - ODD_OVER_FAST), 0.0, 1.0))
