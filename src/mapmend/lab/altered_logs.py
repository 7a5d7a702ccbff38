"""Logs altered for a test of what a map owes to them: the same drive among people, or with its frame turned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.scan import ScanLog


def with_people(log: ScanLog, share: float, seed: int) -> ScanLog:
    """The log with returns from 0.4 m to 3 m in a ``share`` (0 to 1) of its beams, where nothing nearer was."""
    generator, ranges = np.random.default_rng(seed), log.scans.ranges_m.copy()
    hit = generator.uniform(size=len(ranges)) < share
    ranges[hit] = np.minimum(ranges[hit], generator.uniform(0.4, 3.0, hit.sum())).astype(np.float32)
    return replace(log, scans=replace(log.scans, ranges_m=ranges))


def turned(log: ScanLog, turn_rad: float) -> ScanLog:
    """The same drive with another name for "ahead": the map's frame is that of the first pose, so the map turns.

    The robot's new frame is turned by ``-turn_rad`` on the spot; the odometry model is the same in all directions.
    """
    T_robot_frame: NDArray[np.float64] = np.array((0.0, 0.0, -turn_rad))
    geometries = tuple(
        replace(g, T_robot_laser=tuple(se2.between(T_robot_frame, g.T_robot_laser).tolist()))
        for g in log.scans.geometries
    )
    return replace(
        log, scans=replace(log.scans, geometries=geometries), odometry=se2.compose(log.odometry, T_robot_frame)
    )
