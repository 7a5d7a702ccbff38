"""Scan logs to CARMEN's text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapmend.geometry.se2 import compose
from mapmend.io.laser_scans import EXACT_MARK
from mapmend.io.laser_text import numbers, readings, robot_laser_lines
from mapmend.io.output import write_whole
from mapmend.scan import LaserGeometry, ScanLog

_HALF_TURN_DEGREES = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
_LEAST_DECIMALS = 4


def write_carmen(path: str | Path, log: ScanLog) -> None:
    """Write a log as FLASER lines if one laser with half a turn in steps of 1 or 0.5 degrees looks ahead, otherwise as
    ROBOTLASER1 lines; `mapmend.io.carmen.read_carmen` reads back the same log.

    No return is written as the laser's ``max_range_m``, an unusable reading as 0. Raises OutputError.
    """
    lines = [b"# CARMEN log", EXACT_MARK]
    if _fits_flaser(log.scans.geometries):
        lines += _flaser_lines(log)
    else:
        stamps = log.stamps_s if log.has_stamps else None
        rows = np.arange(len(log))
        lines += robot_laser_lines(log.scans, log.odometry, stamps, rows, _LEAST_DECIMALS)
    write_whole(path, b"\n".join(lines) + b"\n")


def _fits_flaser(geometries: tuple[LaserGeometry, ...]) -> bool:
    """Whether beam counts and two PARAM lines describe the lasers completely."""
    if len({(g.max_range_m, g.T_robot_laser) for g in geometries}) != 1:
        return False
    if geometries[0].T_robot_laser[1:] != (0.0, 0.0):
        return False
    return all(
        g.beam_count in _HALF_TURN_DEGREES
        and abs(g.first_angle_rad + np.pi / 2.0) < 1e-12
        and abs(g.angle_increment_rad - np.deg2rad(_HALF_TURN_DEGREES[g.beam_count])) < 1e-12
        for g in geometries
    )


def _flaser_lines(log: ScanLog) -> list[bytes]:
    first = log.scans.geometries[0]
    lines = [
        f"PARAM robot_frontlaser_offset {float(first.T_robot_laser[0])!r} mapmend 0".encode(),
        f"PARAM robot_front_laser_max {float(first.max_range_m)!r} mapmend 0".encode(),
    ]
    laser = compose(log.odometry, np.array(first.T_robot_laser))
    texts = readings(log.scans, _LEAST_DECIMALS)
    counts = np.diff(log.scans.offsets).tolist()
    for k, text in enumerate(texts):
        tail = f" {numbers(laser[k])} {numbers(log.odometry[k])}"
        if log.has_stamps:
            tail += f" {float(log.stamps_s[k])!r} mapmend {log.stamps_s[k] - log.stamps_s[0]:.6f}"
        lines.append(f"FLASER {counts[k]}".encode() + text + tail.encode())
    return lines
