"""What can still be gained on a drive through the corridor without wheels: `corridor.py`'s ``known ends``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.simulation import Simulation
from mapmend.simulation.ray_casting import cast_rays
from mapmend.simulation.robot import HALF_CIRCLE_LASER

Float = NDArray[np.float64]

STEP_M = 0.01
"""How far a robot is moved along its heading to see how its ranges change."""

LEAST_STD_M = 0.009
"""A scan leaves the motion along the corridor open if it fixes it no better than this; others fix it to 1 mm to 4
mm."""

JUMP = 3.0
"""A range that changes by this many times the step has met another wall, and is not used."""

SHORTEST_GAP = 8
"""Two open stretches with at most this many scans between them are one."""

BEFORE, SKIPPED, AFTER = 20, 30, 30
"""The numbers of scans whose speed counts: before an open stretch, skipped after it, and after that.

Right after it, laser odometry measures its own smear of the wall that has just come into sight.
"""


def open_stretches(simulation: Simulation, range_std_m: float = 0.01) -> list[tuple[int, int]]:
    """Rows of scans, from and to, that do not observe the motion along the robot's heading, by rays without noise."""
    truth, laser = simulation.truth, HALF_CIRCLE_LASER
    moved = se2.compose(truth, (STEP_M, 0.0, 0.0))
    here, there = (
        cast_rays(simulation.world.walls, poses, laser.bearings_rad(), laser.max_range_m) for poses in (truth, moved)
    )
    seen = np.isfinite(here) & np.isfinite(there) & (here < laser.max_range_m)
    slope = np.where(seen, np.subtract(there, here, out=np.zeros_like(here), where=seen) / STEP_M, 0.0)
    information = np.where(np.abs(slope) < JUMP, slope**2, 0.0).sum(axis=1) / range_std_m**2
    is_open = information * LEAST_STD_M**2 < 1.0
    edges = np.flatnonzero(np.diff(np.concatenate(([0], is_open.astype(int), [0]))))
    stretches: list[tuple[int, int]] = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if stretches and begin - stretches[-1][1] < SHORTEST_GAP:
            stretches[-1] = (stretches[-1][0], end)
        else:
            stretches.append((begin, end))
    return stretches


def known_ends(simulation: Simulation, measured: Float) -> Float:
    """The truth, (n, 3), but for the length of steps in open stretches, filled from the ``measured`` (n, 3) speeds."""
    steps = se2.between(simulation.truth[:-1], simulation.truth[1:])
    speeds = se2.between(measured[:-1], measured[1:])[:, 0]
    for begin, end in open_stretches(simulation):
        before = speeds[max(begin - BEFORE, 0) : begin]
        after = speeds[end + SKIPPED : end + SKIPPED + AFTER]
        first = before.mean() if len(before) else after.mean()
        last = after.mean() if len(after) == AFTER else first
        rows = np.arange(begin, min(end, len(steps)))
        steps[rows, 0] = np.interp(rows, (begin, end), (first, last))
    poses = [simulation.truth[0]]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)
