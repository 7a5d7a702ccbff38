"""From parsed laser lines to scans: beam directions, mountings, and what is no return."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry.se2 import between, wrap_angle
from mapmend.io._decimals import Bool, Float, Int
from mapmend.io.laser_lines import LaserRows
from mapmend.io.no_return import no_return_limit_m
from mapmend.scan import LaserGeometry, Scans

EXACT_MARK = b"# mapmend: maximum ranges are exact"  # in our own files: nothing has to be guessed
_SAME_M, _SAME_RAD = 1e-3, 1e-3
_QUARTER_DEGREE = np.pi / 720.0


@dataclass(frozen=True)
class Channel:
    """One laser of a file: its mounting, and the greatest range that the file claims (None: no claim)."""

    mounting: tuple[float, float, float]
    claimed_max_m: float | None = None


def constant_mounting(robot: Float, laser: Float) -> tuple[float, float, float] | None:
    """The laser's pose on the robot if it is the same, to 1 mm and 1 mrad, in all rows of (n, 3); otherwise None.

    Rounded to what the spread of the rows supports: positions written with six decimals give 0.22, not 0.219999.
    """
    if not len(robot):
        return None
    T_robot_laser = between(robot, laser)
    T_robot_laser[:, 2] = T_robot_laser[0, 2] + wrap_angle(T_robot_laser[:, 2] - T_robot_laser[0, 2])
    middle = np.median(T_robot_laser, axis=0)
    spread = np.abs(T_robot_laser - middle).max(axis=0)
    if max(spread[0], spread[1]) > _SAME_M or spread[2] > _SAME_RAD:
        return None
    x, y, yaw = (float(np.round(m, _decimals(s))) for m, s in zip(middle, spread, strict=True))
    yaw = float(np.pi) if abs(abs(yaw) - np.pi) < max(1e-6, 2.0 * float(spread[2])) else yaw
    return x + 0.0, y + 0.0, yaw + 0.0


def _decimals(spread: float) -> int:
    return int(np.clip(np.floor(-np.log10(spread + 1e-13)), 4, 12))


def exact_angles(angles_rad: Float) -> Float:
    """Angles that were printed with six decimals, restored to the multiples of a quarter degree that they stand for."""
    printed = np.abs(angles_rad * 1e6 - np.rint(angles_rad * 1e6)) < 1e-6
    quarter = np.rint(angles_rad / _QUARTER_DEGREE) * _QUARTER_DEGREE
    return np.where(printed & (np.abs(angles_rad - quarter) < 1e-6), quarter, angles_rad)


def build_scans(rows: LaserRows, angles: Float, channels: dict[int, Channel], exact: bool) -> Scans:
    """Scans of the rows; ``angles``: (k, 2), first angle and increment.

    The greatest range is the claim of the row or of its channel. With ``exact`` only that claim counts; otherwise the
    readings count too (`no_return_limit_m`). Zero readings become nan.
    """
    claimed = np.array([np.nan if (c := channels[k].claimed_max_m) is None else c for k in sorted(channels)])
    position = np.searchsorted(sorted(channels), rows.channel)
    own = rows.header[:, 3]
    claims = np.where(own > 0.0, own, claimed[position])
    ranges = rows.readings.copy()
    ranges[ranges == 0.0] = np.nan
    limits = _limits(ranges, rows, claims, exact)
    none = ranges >= np.repeat(limits, rows.counts).astype(np.float32)
    ranges[none] = np.inf
    keys: Float = np.column_stack((rows.channel, rows.counts, angles, limits))
    distinct, index = _distinct_rows(keys)
    geometries = tuple(
        LaserGeometry(int(key[1]), float(key[2]), float(key[3]), float(key[4]), channels[int(key[0])].mounting)
        for key in distinct
    )
    return Scans(ranges, rows.offsets(), index.astype(np.int32), geometries)


def _limits(ranges: NDArray[np.float32], rows: LaserRows, claims: Float, exact: bool) -> Float:
    """The least reading of each row that is no return; those of one laser with one claim share it."""
    if exact and not np.any(np.isnan(claims)):
        return claims
    limits = claims.copy()
    groups: Float = np.column_stack((rows.channel, np.nan_to_num(claims)))
    distinct, index = _distinct_rows(groups)
    for k in range(len(distinct)):
        mine: Bool = index == k
        readings = ranges if mine.all() else ranges[np.repeat(mine, rows.counts)]
        claim = claims[np.argmax(mine)]
        limits[mine] = no_return_limit_m(readings, None if np.isnan(claim) else float(claim))
    return limits


def _distinct_rows(keys: Float) -> tuple[Float, Int]:
    """The distinct rows in the order of their first appearance, and which of them each row is."""
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return keys[first[order]], rank[inverse.reshape(-1)]
