"""LaserScan messages into scans: REP-117, angles, lasers, all readings in one array."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.io.bags.frames import Mounting
from mapmend.io.bags.messages import BadMessageError, LaserMessage
from mapmend.io.bags.readings import Readings, as_scans
from mapmend.io.no_return import no_return_limit_m
from mapmend.scan import LaserGeometry, Note, Scans

_QUARTER_DEGREE = np.pi / 720.0
_LOOKED_AT = 1 << 22  # how many readings are used to find the value for "no return"
_FARTHEST_M = 1e4  # for a laser that gives no greatest range


class Laser(NamedTuple):
    """The laser as described in a message; all messages with the same key have the same geometry."""

    frame: str
    beams: int
    first_angle_rad: float
    angle_increment_rad: float
    time_increment_s: float
    range_min_m: float
    range_max_m: float


class Sweeps:
    """The scans of a topic, collected one by one: only their readings are kept, as float32."""

    def __init__(self, expected: int) -> None:
        self._expected = expected
        self._readings = Readings()
        self._offsets = array("q", (0,))
        self._index = array("i")
        self._lasers: dict[Laser, int] = {}
        self._has_infinite = False
        self.stamps_ns = array("q")
        self.received_ns = array("q")

    def __len__(self) -> int:
        return len(self._index)

    @property
    def lasers(self) -> list[Laser]:
        return list(self._lasers)

    def add(self, message: LaserMessage, received_ns: int) -> None:
        """Takes one scan; raises BadMessageError for angles that are not numbers."""
        count = len(message.ranges_m)
        key = Laser(
            message.frame,
            count,
            message.first_angle_rad,
            message.angle_increment_rad,
            message.time_increment_s,
            message.range_min_m,
            message.range_max_m,
        )
        if key not in self._lasers:
            _check_angles(key)
            self._lasers[key] = len(self._lasers)
            if len(self._lasers) == 1:  # usually all scans are as long as the first
                self._readings = Readings(self._expected * count)
        readings = message.ranges_m.astype(np.float32)
        self._has_infinite |= _apply_rep117(readings, key.range_min_m, key.range_max_m)
        self._readings.append(readings)
        self._offsets.append(len(self._readings))
        self._index.append(self._lasers[key])
        self.stamps_ns.append(message.stamp_ns)
        self.received_ns.append(received_ns)

    def scans(self, mountings: Mapping[str, Mounting], notes: list[Note]) -> Scans:
        """All scans, the beams of each counter-clockwise; ``mountings`` by the lasers' frames."""
        readings = self._readings
        offsets = np.frombuffer(self._offsets, np.int64).copy()
        index = np.frombuffer(self._index, np.int32).copy()
        limits = self._limits(readings, offsets, notes)
        geometries = []
        for k, laser in enumerate(self.lasers):
            geometry, turned = _geometry(laser, mountings[laser.frame], limits[k])
            geometries.append(geometry)
            if turned:
                _turn(readings, offsets, np.flatnonzero(index == k))
        return as_scans(readings, offsets, index, tuple(geometries))

    def _limits(self, readings: Readings, offsets: NDArray[np.int64], notes: list[Note]) -> list[float]:
        """The least reading of each laser that is no return: its own value, unless it never reports +inf."""
        claims = [laser.range_max_m for laser in self.lasers]
        if self._has_infinite or not len(readings):
            return [_number(claim) for claim in claims]
        step = max(len(readings) // _LOOKED_AT, 1)
        starts, ends = offsets[:-1][::step], offsets[1:][::step]
        looked = np.concatenate([readings.read(a, b) for a, b in zip(starts.tolist(), ends.tolist(), strict=True)])
        told = {claim: no_return_limit_m(looked, _claim(claim)) for claim in set(claims)}
        limits = [told[claim] for claim in claims]
        lower = min(limits) < min(map(_number, claims))
        if lower:
            _cut(readings, min(limits))
            notes.append(Note(f"readings from {min(limits):g} m on taken as no return; the laser says none"))
        return limits


def _apply_rep117(readings: NDArray[np.float32], least: float, most: float) -> bool:
    """In place: no return becomes inf, every other invalid reading nan. Returns whether there was +inf.

    REP-117: -inf is too close, nan an error, +inf nothing in range. Before REP-117: the greatest range, or more, for
    nothing in range; less than the least range for too close.
    """
    infinite = bool(np.isposinf(readings).any())
    readings[~(readings > 0.0) | (readings < np.float32(least))] = np.nan
    if most > 0.0:
        readings[readings >= np.float32(most)] = np.inf
    return infinite


def _cut(readings: Readings, limit_m: float) -> None:
    for begin, part in readings.blocks():
        part[part >= np.float32(limit_m)] = np.inf
        readings.write(begin, part)


def _check_angles(laser: Laser) -> None:
    if not np.all(np.isfinite((laser.first_angle_rad, laser.angle_increment_rad))):
        raise BadMessageError("the angles are no numbers")
    if laser.beams > 1 and laser.angle_increment_rad == 0.0:
        raise BadMessageError("the angle increment is 0")


def _geometry(laser: Laser, mounting: Mounting, limit_m: float) -> tuple[LaserGeometry, bool]:
    """The laser on its robot, counter-clockwise, and whether its readings must be reversed for that."""
    first, step = double_angle(laser.first_angle_rad), double_angle(laser.angle_increment_rad)
    if mounting.upside_down:
        first, step = -first, -step
    turned = step < 0.0
    if turned:
        first, step = first + step * max(laser.beams - 1, 0), -step
    return LaserGeometry(laser.beams, first, step, limit_m, mounting.pose), turned


def _turn(readings: Readings, offsets: NDArray[np.int64], rows: NDArray[np.int64]) -> None:
    """Reverses the readings of the given scans, in place."""
    for a, b in zip(offsets[rows].tolist(), offsets[rows + 1].tolist(), strict=True):
        readings.write(a, readings.read(a, b)[::-1].copy())


def double_angle(angle_rad: float) -> float:
    """An angle of a float32 field: the multiple of a quarter degree that it stands for, if it is one."""
    quarter = round(angle_rad / _QUARTER_DEGREE) * _QUARTER_DEGREE
    return quarter if np.float32(quarter) == np.float32(angle_rad) else float(angle_rad)


def _claim(single: float) -> float | None:
    """The decimal number that a float32 field stands for, 81.83 and not 81.83000183; None if it is no range."""
    value = float(str(np.float32(single)))
    return value if np.isfinite(value) and value > 0.0 else None


def _number(single: float) -> float:
    return _claim(single) or _FARTHEST_M
