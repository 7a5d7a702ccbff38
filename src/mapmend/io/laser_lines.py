"""FLASER, RLASER and ROBOTLASER lines to arrays: used for logs and for graphs whose nodes carry scans.

All lines of a block are parsed together. A line that does not fit is set aside; it is parsed word by word only for the
error message (`explain`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from mapmend.io._decimals import Bool, Float, Int, Tokens, parse, tokenize

FARTHEST_M = 1e9  # a coordinate beyond this is no place on earth
LATEST_S = 1e12  # a stamp beyond this is not in seconds
_HEADER = (
    "laser type",
    "start angle",
    "field of view",
    "angular resolution",
    "maximum range",
    "accuracy",
    "remission mode",
)
_POSES = ("laser x", "laser y", "laser theta", "robot x", "robot y", "robot theta")
_DRIVING = (
    "translational velocity",
    "rotational velocity",
    "forward safety distance",
    "side safety distance",
    "turn axis",
)
_TAIL = 3  # ipc_timestamp, host, logger_timestamp


@dataclass(frozen=True)
class Layout:
    """The positions of a line's fields: ``FLASER`` has none before the beam count, ``ROBOTLASER`` seven."""

    before_count: tuple[str, ...]
    has_remissions: bool
    after_poses: tuple[str, ...]

    def words_needed(self, counts: Int, remissions: Int) -> Int:
        """How many words a line has without its time, shape (rows,)."""
        return np.asarray(
            len(self.before_count) + 1 + counts + self.has_remissions * (1 + remissions) + 6 + len(self.after_poses)
        )


FLASER = Layout((), False, ())
ROBOTLASER = Layout(_HEADER, True, _DRIVING)


@dataclass(frozen=True)
class LaserRows:
    """k parsed lines, one row each.

    ``lines``: int64 (k,), line numbers. ``channel``: int32 (k,), which laser, as the caller counts them.
    ``header``: (k, 4), first angle, field of view, increment (rad), maximum range (m), nan for FLASER.
    ``counts``: int64 (k,). ``readings``: float32 (sum of counts,), metres as in the file. ``laser``, ``robot``: (k, 3).
    ``stamps_s``: (k,), nan if the line ends before its time.
    """

    lines: Int
    channel: NDArray[np.int32]
    header: Float
    counts: Int
    readings: NDArray[np.float32]
    laser: Float
    robot: Float
    stamps_s: Float

    def __len__(self) -> int:
        return len(self.lines)

    def offsets(self) -> Int:
        return np.concatenate(([0], np.cumsum(self.counts))).astype(np.int64)

    def select(self, rows: Int) -> LaserRows:
        """The given rows, in that order."""
        readings = self.readings[ragged(self.offsets()[:-1][rows], self.counts[rows])]
        kept = {f.name: getattr(self, f.name)[rows] for f in fields(self) if f.name != "readings"}
        return LaserRows(readings=readings, **kept)


@dataclass
class Odd:
    """The lines that `parse_laser_lines` left out or changed."""

    bad: list[int]  # positions, in the list of texts, of the lines left out
    masked_readings: int = 0  # nan, infinite or negative readings made nan
    masked_first_line: int | None = None


def concatenate(parts: list[LaserRows]) -> LaserRows:
    """All rows; those of the same file in the order of their lines."""
    joined = LaserRows(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(LaserRows)})
    if np.all(np.diff(joined.lines) > 0):
        return joined
    return joined.select(np.argsort(joined.lines, kind="stable"))


def ragged(starts: Int, counts: Int) -> Int:
    """The indices ``starts[k] .. starts[k] + counts[k]`` for all k, concatenated."""
    offsets = np.cumsum(counts) - counts
    return np.arange(int(counts.sum())) + np.repeat(starts - offsets, counts)


def parse_laser_lines(
    layout: Layout, texts: list[bytes], lines: list[int], channel: list[int], mask_readings: bool = False
) -> tuple[LaserRows, Odd]:
    """Parse lines without their keyword, each with its number and its laser.

    With ``mask_readings`` a reading that is nan, infinite or negative becomes nan; otherwise its line is left out.
    """
    tokens = tokenize(texts)
    counts, remissions, good = _counts(tokens, layout)
    if good.all() and len(texts):
        rows, good, odd = _values(
            tokens, layout, counts, remissions, lines=np.array(lines), channel=channel, mask_readings=mask_readings
        )
        if good.all():
            return rows, odd
    if not good.any():
        return _no_rows(), Odd(list(range(len(texts))))
    keep = np.flatnonzero(good).tolist()
    rest = ([texts[k] for k in keep], [lines[k] for k in keep], [channel[k] for k in keep])
    rows, odd = parse_laser_lines(layout, *rest, mask_readings)
    odd.bad = sorted(np.flatnonzero(~good).tolist() + [keep[k] for k in odd.bad])
    return rows, odd


def _counts(tokens: Tokens, layout: Layout) -> tuple[Int, Int, Bool]:
    """Each line's beam and remission counts, and which lines have the number of words that follows from these."""
    words = tokens.counts()
    counts, good = _whole_numbers(tokens, np.full(len(words), len(layout.before_count)))
    remissions = np.zeros_like(counts)
    if layout.has_remissions:
        remissions, also_good = _whole_numbers(tokens, len(layout.before_count) + 1 + counts)
        good &= also_good
    left = words - layout.words_needed(counts, remissions)
    return counts, remissions, good & ((left == _TAIL) | (left == 0))


def _whole_numbers(tokens: Tokens, position: Int) -> tuple[Int, Bool]:
    """The counts at a position of each line, 0 where there is none that could be true of the line."""
    words = tokens.counts()
    there = np.flatnonzero(position < words)
    values, valid = parse(tokens, (tokens.first[:-1] + position)[there])
    with np.errstate(invalid="ignore"):
        valid &= (values >= 0) & (values < words[there]) & (values == np.floor(values))
    counts, good = np.zeros(len(words), np.int64), np.zeros(len(words), np.bool_)
    counts[there[valid]], good[there[valid]] = values[valid].astype(np.int64), True
    return counts, good


def _values(
    tokens: Tokens, layout: Layout, counts: Int, remissions: Int, *, lines: Int, channel: list[int], mask_readings: bool
) -> tuple[LaserRows, Bool, Odd]:
    """The numbers in lines that have the right number of words, and which of the lines are usable."""
    first, after = tokens.first[:-1], tokens.first[1:]
    has_time = tokens.counts() > layout.words_needed(counts, remissions)
    values, good = _numbers(tokens, has_time)
    reading_first = first + len(layout.before_count) + 1
    readings = values[ragged(reading_first, counts)]
    odd = _mask_readings(readings, counts, lines, good, mask_readings)
    pose_first = reading_first + counts + layout.has_remissions * (1 + remissions)
    poses = values[pose_first[:, None] + np.arange(6)]
    stamps = np.full(len(counts), np.nan)
    stamps[has_time] = values[after[has_time] - _TAIL]
    good &= np.all(np.abs(poses) <= FARTHEST_M, axis=1) & (~has_time | (np.abs(stamps) <= LATEST_S))
    header = np.full((len(counts), 4), np.nan)
    if layout.has_remissions:
        header = values[first[:, None] + np.arange(1, 5)]
        good &= np.all(np.abs(header) <= FARTHEST_M, axis=1) & ((header[:, 2] != 0.0) | (counts < 2))
    with np.errstate(over="ignore"):
        single = readings.astype(np.float32)
    rows = LaserRows(lines, np.array(channel, np.int32), header, counts, single, poses[:, :3], poses[:, 3:], stamps)
    return rows, good, odd


def _numbers(tokens: Tokens, has_time: Bool) -> tuple[Float, Bool]:
    """The value of every word, nan for the host and the logger's time, and which lines have only numbers elsewhere."""
    used = np.ones(len(tokens.starts), np.bool_)
    last = tokens.first[1:][has_time] - 1
    used[last] = used[last - 1] = False
    where = np.flatnonzero(used)
    values = np.full(len(used), np.nan)
    values[where], valid = parse(tokens, where)
    good = np.ones(len(has_time), np.bool_)
    good[np.searchsorted(tokens.first, where[~valid], side="right") - 1] = False
    return values, good


def _mask_readings(readings: Float, counts: Int, lines: Int, good: Bool, mask: bool) -> Odd:
    """Unusable readings become nan, or otherwise make their lines unusable (in ``good``, in place)."""
    unusable = np.flatnonzero(~((readings >= 0.0) & np.isfinite(readings)))
    if not len(unusable):
        return Odd([])
    rows = np.searchsorted(np.cumsum(counts), unusable, side="right")
    if not mask:
        good[rows] = False
        return Odd([])
    readings[unusable] = np.nan
    return Odd([], len(unusable), int(lines[rows[0]]))


def _no_rows() -> LaserRows:
    return LaserRows(
        np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros((0, 4)), np.zeros(0, np.int64), np.zeros(0, np.float32),
        np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0),
    )  # fmt: skip


def explain(layout: Layout, text: bytes) -> str:
    """The reason why `parse_laser_lines` left a line out."""
    words = text.split()
    at = len(layout.before_count)
    if len(words) <= at:
        return "the line ends before its beam count"
    count, what = _explain_count(words[at], "beam count")
    if what:
        return what
    needed, given = at + 1 + count + 6 + len(layout.after_poses), len(words)
    if layout.has_remissions:
        if len(words) <= at + 1 + count:
            return f"{count} beams claimed, but the line ends after {len(words) - at - 1} readings"
        remissions, what = _explain_count(words[at + 1 + count], "remission count after the readings")
        if what:
            return f"{what}: the beam count {count} disagrees with the readings, or the line is damaged"
        needed += 1 + remissions
    if given not in (needed, needed + _TAIL):
        kind = "is cut short, or its" if given < needed + _TAIL else "has more readings, or its"
        return f"{given} fields where {count} beams make {needed + _TAIL}: the line {kind} beam count is wrong"
    return _explain_words(layout, words[:needed], words[needed:], count)


def _explain_count(word: bytes, name: str) -> tuple[int, str]:
    try:
        count = float(word)
    except ValueError:
        return 0, f"the {name} {_shown(word)} is not a number"
    if not count >= 0 or count != count // 1 or count == float("inf"):
        return 0, f"the {name} {_shown(word)} is not a whole number"
    return int(count), ""


def _explain_words(layout: Layout, words: list[bytes], tail: list[bytes], count: int) -> str:
    at = len(layout.before_count)
    names = [*layout.before_count, "beam count", *(f"reading {k + 1}" for k in range(count))]
    middle = len(words) - len(names) - 6 - len(layout.after_poses)
    names += ["remission"] * middle + [*_POSES, *layout.after_poses]
    for k, (name, word) in enumerate(zip([*names, "stamp"], [*words, *tail[:1]], strict=False)):
        try:
            value = float(word) if b"_" not in word else None
        except ValueError:
            value = None
        if value is None:
            return f"{name} {_shown(word)} is not a number"
        limit = LATEST_S if name == "stamp" else FARTHEST_M
        if at < k <= at + count:
            limit = float("inf")
            if value < 0.0 or abs(value) == limit:
                return f"{name} is {_shown(word)}, not a distance"
        if not abs(value) <= limit:
            return f"{name} is {_shown(word)}, not a usable number"
    return "the angular resolution is 0" if layout.has_remissions else "the line can't be used"


def _shown(word: bytes) -> str:
    """A word of the file, shortened and escaped for one line of a message."""
    return ascii(word[:24].decode("latin-1"))
