"""Scans to ROBOTLASER lines, for writing CARMEN logs, g2o and TORO graphs."""

from __future__ import annotations

import numpy as np

from mapmend.errors import OutputError
from mapmend.geometry.se2 import compose
from mapmend.io._decimals import Float, Int, format_rows
from mapmend.scan import LaserGeometry, Scans

_MOST_LASERS = 9  # ROBOTLASER1 to ROBOTLASER9
_ACCURACY_M = 0.01


def numbers(values: Float) -> str:
    """Numbers as text: the shortest decimals that are read back to the same bits."""
    return " ".join(map(repr, values.tolist()))


def max_ranges_m(scans: Scans) -> Float:
    """Each scan's greatest range, shape (n,)."""
    known = [geometry.max_range_m for geometry in scans.geometries] or [1.0]
    return np.array(known)[scans.geometry_index]


def readings(scans: Scans, least_decimals: int) -> list[bytes]:
    """Each scan's readings as text, a blank before each."""
    return format_rows(scans.ranges_m, scans.offsets, max_ranges_m(scans), least_decimals)


def robot_laser_lines(
    scans: Scans, poses: Float, stamps_s: Float | None, rows: Int, least_decimals: int = 2
) -> list[bytes]:
    """A ROBOTLASER line for each of the given rows; ``poses``: (n, 3), the robot's, for all rows.

    Lasers that are mounted differently get separate keywords. Raises OutputError for more than nine of them.
    """
    texts = readings(scans, least_decimals)
    keywords = _keywords(scans.geometries)
    heads = [_head(geometry) for geometry in scans.geometries]
    mountings = np.array([g.T_robot_laser for g in scans.geometries]).reshape(-1, 3)
    laser = compose(poses, mountings[scans.geometry_index]) if len(mountings) else poses
    start = 0.0 if stamps_s is None or not len(rows) else float(stamps_s[rows[0]])
    counts = np.diff(scans.offsets).tolist()
    lines = []
    for k in rows.tolist():
        which = int(scans.geometry_index[k])
        keyword, head = (keywords[which], heads[which]) if heads else ("ROBOTLASER1", "0 0 0 0 0 0 0")
        tail = f" 0 {numbers(laser[k])} {numbers(poses[k])} 0 0 0 0 0"
        if stamps_s is not None and np.isfinite(stamps_s[k]):
            tail += f" {float(stamps_s[k])!r} mapmend {stamps_s[k] - start:.6f}"
        lines.append(f"{keyword} {head} {counts[k]}".encode() + texts[k] + tail.encode())
    return lines


def _head(geometry: LaserGeometry) -> str:
    view = geometry.angle_increment_rad * max(geometry.beam_count - 1, 0)
    first, step, most = geometry.first_angle_rad, geometry.angle_increment_rad, geometry.max_range_m
    return f"0 {float(first)!r} {float(view)!r} {float(step)!r} {float(most)!r} {_ACCURACY_M} 0"


def _keywords(geometries: tuple[LaserGeometry, ...]) -> list[str]:
    mountings = list(dict.fromkeys(tuple(g.T_robot_laser) for g in geometries))
    if len(mountings) > _MOST_LASERS:
        raise OutputError(f"{len(mountings)} lasers mounted differently; the format has room for {_MOST_LASERS}")
    return [f"ROBOTLASER{mountings.index(tuple(g.T_robot_laser)) + 1}" for g in geometries]
