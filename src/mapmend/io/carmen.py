"""CARMEN logs: FLASER, RLASER and ROBOTLASER lines with their odometry. docs/formats.md lists fields and rules."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mapmend.errors import InputError
from mapmend.geometry.se2 import between
from mapmend.io._decimals import Bool, Float
from mapmend.io.carmen_text import write_carmen
from mapmend.io.files import read_bytes
from mapmend.io.laser_lines import FLASER, ROBOTLASER, LaserRows, Layout, concatenate, explain, parse_laser_lines
from mapmend.io.laser_scans import EXACT_MARK, Channel, build_scans, constant_mounting, exact_angles
from mapmend.scan import Note, ScanLog

__all__ = ["parse_carmen", "read_carmen", "write_carmen"]

MEND_LINE = "repair the line, or pass --lenient to leave such lines out"

_FRONT, _REAR = 0, 1  # channels of FLASER and RLASER; ROBOTLASERk has channel k + 1
_KEYWORDS: dict[bytes, tuple[Layout, int]] = {
    b"FLASER": (FLASER, _FRONT),
    b"RLASER": (FLASER, _REAR),
    **{b"ROBOTLASER%d" % k: (ROBOTLASER, k + 1) for k in range(1, 10)},
}
_SIDES = {_FRONT: "front", _REAR: "rear"}
_BLOCK_BYTES = 1 << 22
_JUMP_M, _JUMP_RAD = 1.0, 1.0
_HALF_TURN_DEGREES = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}


@dataclass
class _Content:
    """The content of the lines of a log, collected block by block."""

    rows: list[LaserRows] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    exact: bool = False
    left_out: list[int] = field(default_factory=list)  # line numbers
    masked: int = 0
    masked_first_line: int | None = None


def read_carmen(path: str | Path, lenient: bool = False) -> ScanLog:
    """Read a CARMEN log, plain or compressed; raises InputError that names file, line and what to do.

    With ``lenient`` unusable lines are left out, and nan, infinite or negative readings become nan; notes count them.
    """
    return parse_carmen(read_bytes(path), path, lenient)


def parse_carmen(data: bytes, path: str | Path, lenient: bool = False) -> ScanLog:
    """The same for bytes already read; ``path`` is for messages."""
    if not data or data.isspace():
        raise InputError(path, "the file is empty", "name a log with scans")
    content = _Content()
    for first_line, lines in _blocks(data):
        _read_block(content, first_line, lines, path, lenient)
    rows = concatenate(content.rows) if content.rows else None
    rows = None if rows is None else _usable_rows(rows, content, path, lenient)
    if rows is None or not len(rows):
        what = "no usable scans" if content.left_out else "no scans (FLASER, RLASER or ROBOTLASER1 lines)"
        raise InputError(path, what, "name a CARMEN log with laser scans")
    return _build_log(rows, content, path)


def _blocks(data: bytes) -> Iterator[tuple[int, list[bytes]]]:
    """The lines in blocks of some megabytes, each with the number of its first line."""
    begin, line = 0, 1
    while begin < len(data):
        end = data.find(b"\n", begin + _BLOCK_BYTES)
        end = len(data) if end < 0 else end
        lines = data[begin:end].split(b"\n")
        yield line, lines
        begin, line = end + 1, line + len(lines)


def _read_block(content: _Content, first_line: int, lines: list[bytes], path: str | Path, lenient: bool) -> None:
    found: dict[int, tuple[Layout, list[bytes], list[int], list[int]]] = {}
    for number, line in enumerate(lines, first_line):
        words = line[:12].split(None, 1)
        if not words or words[0] == b"ODOM":
            continue
        keyword = words[0]
        if keyword in _KEYWORDS:
            layout, channel = _KEYWORDS[keyword]
            _, texts, numbers, channels = found.setdefault(id(layout), (layout, [], [], []))
            texts.append(line[line.index(keyword) + len(keyword) :])
            numbers.append(number)
            channels.append(channel)
        elif keyword == b"PARAM":
            _read_parameter(content.parameters, line)
        elif line.startswith(EXACT_MARK):
            content.exact = True
    bad: list[tuple[int, Layout, bytes]] = []
    for layout, texts, numbers, channels in found.values():
        rows, odd = parse_laser_lines(layout, texts, numbers, channels, mask_readings=lenient)
        content.rows.append(rows)
        content.masked += odd.masked_readings
        if content.masked_first_line is None:
            content.masked_first_line = odd.masked_first_line
        bad += [(numbers[k], layout, texts[k]) for k in odd.bad]
    if bad and not lenient:
        number, layout, text = min(bad, key=lambda entry: entry[0])
        raise InputError(path, explain(layout, text), MEND_LINE, number)
    content.left_out += [entry[0] for entry in bad]


def _read_parameter(parameters: dict[str, str], line: bytes) -> None:
    words = line.decode("latin-1").split()
    if len(words) >= 3:
        parameters[words[1]] = words[2]


def _number(parameters: dict[str, str], *names: str) -> float | None:
    """The first of the parameters that exists and is a finite number."""
    for name in names:
        try:
            value = float(parameters[name])
        except (KeyError, ValueError):
            continue
        if abs(value) <= 1e6:
            return value
    return None


def _usable_rows(rows: LaserRows, content: _Content, path: str | Path, lenient: bool) -> LaserRows:
    """The rows that have beams and end like the others: all lines end with their time, or none does."""
    untimed: Bool = np.isnan(rows.stamps_s)
    checks = [(rows.counts == 0, "a scan without beams")]
    if not untimed.all():
        checks.append((untimed, "the line ends before its timestamp, which other lines have"))
    keep = np.ones(len(rows), np.bool_)
    for wrong, what in checks:
        if wrong.any() and not lenient:
            raise InputError(path, what, MEND_LINE, int(rows.lines[np.argmax(wrong)]))
        keep &= ~wrong
    if keep.all():
        return rows
    content.left_out += rows.lines[~keep].tolist()
    return rows.select(np.flatnonzero(keep))


def _build_log(rows: LaserRows, content: _Content, path: str | Path) -> ScanLog:
    notes: list[Note] = []
    if content.left_out:
        notes.append(Note("unusable line left out", len(content.left_out), min(content.left_out)))
    if content.masked:
        notes.append(Note("reading nan, infinite or negative, left out", content.masked, content.masked_first_line))
    channels = {int(k): _channel(int(k), rows, content.parameters, notes) for k in np.unique(rows.channel)}
    angles = _angles(rows, content.parameters, notes)
    zeros = int(np.count_nonzero(rows.readings == 0.0))
    if zeros:
        notes.append(Note("reading of zero, taken as unusable", zeros))
    scans = build_scans(rows, angles, channels, content.exact)
    if not content.exact:
        notes += _limit_notes(rows, channels, {g.max_range_m for g in scans.geometries})
    stamps, has_stamps = _stamps(rows, content.exact, notes)
    _note_jumps(rows, notes)
    return ScanLog(scans, stamps, rows.robot.copy(), has_stamps, str(path), tuple(notes))


def _channel(channel: int, rows: LaserRows, parameters: dict[str, str], notes: list[Note]) -> Channel:
    """Mounting and claimed range of one laser, from PARAM lines or from the two poses of its lines."""
    mine = rows.channel == channel
    measured = constant_mounting(rows.robot[mine], rows.laser[mine])
    line = int(rows.lines[np.argmax(mine)])
    if channel not in _SIDES:
        if measured is None:
            notes.append(
                Note("laser and robot pose do not differ by a mounting; the laser is put at the robot's centre")
            )
        return Channel(measured or (0.0, 0.0, 0.0))
    side = _SIDES[channel]
    yaw = np.pi if channel == _REAR else 0.0
    claimed = _number(parameters, f"robot_{side}_laser_max", f"laser_{side}_laser_max")
    claimed = claimed if claimed is not None and claimed > 0.0 else None
    offset = _number(parameters, f"robot_{side}laser_offset")
    if offset is not None:
        if measured is not None and float(np.hypot(measured[0] - offset, measured[1])) > 0.01:
            place = f"({measured[0]:g}, {measured[1]:g})"
            notes.append(Note(f"PARAM puts the {side} laser at x = {offset:g} m, its poses at {place}", 1, line))
        return Channel((offset, 0.0, yaw), claimed)
    if measured is None:
        what = f"the {side} laser's pose is corrected or not on the robot; it is put at the robot's centre"
        notes.append(Note(what, int(mine.sum()), line))
        return Channel((0.0, 0.0, yaw), claimed)
    return Channel(measured, claimed)


def _angles(rows: LaserRows, parameters: dict[str, str], notes: list[Note]) -> Float:
    """First angle and increment of each row, shape (k, 2): from the header, or from the beam count."""
    angles = exact_angles(rows.header[:, [0, 2]])
    for channel, side in _SIDES.items():
        mine = rows.channel == channel
        for count in np.unique(rows.counts[mine]):
            these = mine & (rows.counts == count)
            first, increment, guessed = _angles_of(int(count), side, parameters)
            angles[these] = first, increment
            if guessed:
                what = f"no angles given for {count} beams, {np.rad2deg(-2 * first):g} degrees taken as field of view"
                notes.append(Note(what, int(these.sum()), int(rows.lines[np.argmax(these)])))
    return angles


def _angles_of(count: int, side: str, parameters: dict[str, str]) -> tuple[float, float, bool]:
    """First angle, increment and whether they are guessed, for a line with nothing but its beam count."""
    if count in _HALF_TURN_DEGREES:
        return -np.pi / 2.0, float(np.deg2rad(_HALF_TURN_DEGREES[count])), False
    gaps = max(count - count % 2, 1)  # an even number of beams covers the field without its last direction
    resolution = _number(parameters, f"laser_{side}_laser_resolution")
    if resolution is not None and 0.0 < resolution * gaps <= 361.0:
        increment = float(np.deg2rad(resolution))
        return -increment * gaps / 2.0, increment, False
    view = _number(parameters, f"laser_{side}_laser_fov", "robot_laser_fov")
    if view is not None and 0.0 < view <= 360.0:
        view = float(np.deg2rad(view)) if view > 2.0 * np.pi + 1e-3 else view
        return -view / 2.0, view / gaps, False
    return -np.pi / 2.0, np.pi / gaps, True


def _limit_notes(rows: LaserRows, channels: dict[int, Channel], limits: set[float]) -> list[Note]:
    """Notes if the readings, and not the limit in the file, decided what is no return."""
    claims = {c.claimed_max_m for c in channels.values() if c.claimed_max_m is not None}
    claims |= set(rows.header[rows.header[:, 3] > 0.0, 3].tolist())
    told = f"the file says {', '.join(f'{c:g}' for c in sorted(claims))}" if claims else "the file says none"
    return [
        Note(f"readings from {limit:g} m on taken as no return; {told}")
        for limit in sorted(limits)
        if limit not in claims
    ]


def _stamps(rows: LaserRows, exact: bool, notes: list[Note]) -> tuple[Float, bool]:
    """The rows' times, or their numbers if the times are not usable."""
    stamps = rows.stamps_s
    what = ""
    if np.isnan(stamps).any():
        what = "no timestamps"
    elif len(stamps) > 1 and np.all(stamps == stamps[0]):
        what = "all timestamps are equal"
    elif len(stamps) > 2 and not exact and np.all(np.diff(stamps) == 1.0) and stamps[0] in (0.0, 1.0):
        what = "the timestamps only count the scans"
    if what:
        notes.append(Note(f"{what}; the scans are numbered instead"))
        return np.arange(len(stamps), dtype=np.float64), False
    steps = np.diff(stamps)
    for what, odd in (("timestamp steps back", steps < 0.0), ("timestamp repeats the one before", steps == 0.0)):
        if odd.any():
            notes.append(Note(what, int(odd.sum()), int(rows.lines[1:][np.argmax(odd)])))
    return stamps.copy(), True


def _note_jumps(rows: LaserRows, notes: list[Note]) -> None:
    step = between(rows.robot[:-1], rows.robot[1:])
    jump = (np.hypot(step[:, 0], step[:, 1]) > _JUMP_M) | (np.abs(step[:, 2]) > _JUMP_RAD)
    if jump.any():
        what = f"odometry jumps by more than {_JUMP_M:g} m or {_JUMP_RAD:g} rad between two scans"
        notes.append(Note(what, int(jump.sum()), int(rows.lines[1:][np.argmax(jump)])))
