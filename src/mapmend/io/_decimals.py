"""Decimal numbers from text and to text, a whole block at once.

A log is millions of short numbers such as ``12.34``. Sixteen characters of each are treated as two 64-bit words, so
that NumPy does the arithmetic for all of them together. Numbers with all digits of a double, as in pose graphs, have a
kernel (``_decimal_kernels``), and the others go through ``float``. The values are those of ``float`` to the last bit:
here, because digits below 2**53 divided by an exact power of ten round correctly.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Words = NDArray[np.uint64]
Bool = NDArray[np.bool_]

_PAD = 16  # words are read from up to this far before their end
_CHUNK = 1 << 15  # how many numbers are processed together: the words of a chunk stay in the cache
_MOST_DECIMALS = 12
_FEW = 200  # after this many words read by ``float``, the compiled kernel is loaded
_LONG = 10.0  # if words have more characters on average, most of them are for the kernel
_POWERS = 10.0 ** np.arange(17)


def _word(text: str) -> np.uint64:
    return np.uint64(int.from_bytes(text.encode("latin-1"), "little"))


_ZEROS, _DOTS = _word("00000000"), _word("........")
_ONES, _TOPS, _SIXES = _word("\x01" * 8), _word("\x80" * 8), _word("\x06" * 8)
_HIGH_NIBBLES, _THREES = _word("\xf0" * 8), _word("\x33" * 8)
_LOW_NIBBLES = _word("\x0f" * 8)
_LAST = np.array([(0xFFFFFFFFFFFFFFFF << 8 * (8 - k)) & 0xFFFFFFFFFFFFFFFF for k in range(9)], np.uint64)
_ZERO, _255 = np.uint64(ord("0")), np.uint64(255)
_1, _4, _7, _8, _56 = (np.uint64(k) for k in (1, 4, 7, 8, 56))


@dataclass(frozen=True)
class Tokens:
    """The blank-separated words of a block of lines: word k is ``buffer[starts[k]:ends[k]]``.

    ``first``: int64, shape (rows + 1,), the words of line r are ``first[r]`` up to ``first[r + 1]``.
    """

    buffer: NDArray[np.uint8]
    starts: Int
    ends: Int
    first: Int

    def counts(self) -> Int:
        """How many words each line has, shape (rows,)."""
        return np.diff(self.first)

    def text(self, k: int) -> bytes:
        return self.buffer[self.starts[k] : self.ends[k]].tobytes()


def tokenize(lines: list[bytes]) -> Tokens:
    """The positions of the words in the lines; any byte up to the blank separates them."""
    return tokenize_text(b"\n".join(lines) + b"\n")


def tokenize_text(text: bytes) -> Tokens:
    """The same for lines in one text, each with its line end."""
    buffer = np.frombuffer(b" " * _PAD + text, np.uint8)
    blank = buffer <= 32
    change = np.flatnonzero(blank[1:] != blank[:-1]) + 1
    starts, ends = change[0::2], change[1::2]
    first = np.concatenate(([0], np.searchsorted(starts, np.flatnonzero(buffer == ord("\n")))))
    return Tokens(buffer, starts, ends, first)


def parse(tokens: Tokens, rows: Int | slice = slice(None)) -> tuple[Float, Bool]:
    """The values of the words ``rows``, shape (n,), and whether each is a number at all (``nan`` and ``inf`` are)."""
    starts, ends = tokens.starts[rows], tokens.ends[rows]
    values = np.empty(len(starts))
    valid = np.ones(len(starts), np.bool_)
    if len(starts) and float((ends - starts).mean()) > _LONG:
        return _parse_odd(tokens.buffer, starts, ends)
    for begin in range(0, len(starts), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        values[part], plain = _parse_plain(tokens.buffer, starts[part], ends[part])
        odd = begin + np.flatnonzero(~plain)
        if len(odd):
            values[odd], valid[odd] = _parse_odd(tokens.buffer, starts[odd], ends[odd])
    return values, valid


def _parse_plain(buffer: NDArray[np.uint8], starts: Int, ends: Int) -> tuple[Float, Bool]:
    """Values of words such as ``12``, ``-1.5`` and ``.25``, and which words are of that kind."""
    words = np.ndarray((len(buffer) - 7,), "<u8", buffer, strides=(1,))
    negative = buffer[starts] == ord("-")
    lengths = ends - starts - negative
    low, has_dot, decimals = _without_dot(_digits_only(words[ends - 8], np.minimum(lengths, 8)))
    integers = _eight_digits(low)
    plain = _all_digits(low) & (lengths > has_dot)
    long = np.flatnonzero(lengths > 8)
    if len(long):
        integers[long], decimals[long], plain[long] = _sixteen_characters(words, ends[long], lengths[long])
    values = integers.astype(np.float64)
    values /= _POWERS[decimals]
    np.negative(values, out=values, where=negative)
    return values, plain


def _sixteen_characters(words: Words, ends: Int, lengths: Int) -> tuple[Words, NDArray[np.uint8], Bool]:
    """Digits, decimals and plainness of words longer than eight characters: a second machine word before the first."""
    raw = _digits_only(words[ends - 16], np.minimum(lengths, 16) - 8)
    high, high_dot, high_decimals = _without_dot(raw)
    low, low_dot, low_decimals = _without_dot(words[ends - 8])
    # If the dot was among the last eight, these have one digit too few: the last digit before them moves down.
    low = np.where(low_dot, (low & ~np.uint64(0xFF)) | (raw >> _56), low)
    high = np.where(low_dot, (raw << _8) | np.uint64(ord("0")), high)
    decimals = np.where(high_dot, high_decimals + np.uint8(8), low_decimals)
    integers = _eight_digits(high) * np.uint64(10**8) + _eight_digits(low)
    plain = _all_digits(low) & _all_digits(high) & ~(low_dot & high_dot)
    return integers, decimals, plain & (lengths <= 16) & (integers < np.uint64(2**53))


def _digits_only(word: Words, length: Int) -> Words:
    """The last ``length`` (0 to 8) characters of each word, zeros before them."""
    mask = _LAST[length]
    return (word & mask) | (_ZEROS & ~mask)


def _without_dot(word: Words) -> tuple[Words, Bool, NDArray[np.uint8]]:
    """The words without their dot, whether they had one, and how many characters followed it."""
    other = word ^ _DOTS
    found = (other - _ONES) & ~other & _TOPS
    found &= ~found + _1  # only the lowest dot; a second one stays and is refused because it is no digit
    bit = found >> _7
    has_dot = bit != 0
    before = bit - has_dot
    dot = bit * _255
    closed = np.where(has_dot, (word & ~(before | dot)) | ((word & before) << _8) | _ZERO, word)
    decimals = (np.uint8(7) - (np.bitwise_count(before) >> np.uint8(3))) * has_dot
    return closed, has_dot, decimals


def _all_digits(word: Words) -> Bool:
    return ((word & _HIGH_NIBBLES) | (((word + _SIXES) & _HIGH_NIBBLES) >> _4)) == _THREES


def _eight_digits(word: Words) -> Words:
    """The number of eight digit characters: neighbours are joined to pairs, fours and the whole."""
    twos = ((word & _LOW_NIBBLES) * np.uint64(1 + (10 << 8)) >> _8) & np.uint64(0x00FF00FF00FF00FF)
    fours = (twos * np.uint64(1 + (100 << 16)) >> np.uint64(16)) & np.uint64(0x0000FFFF0000FFFF)
    return fours * np.uint64(1 + (10000 << 32)) >> np.uint64(32)


def _parse_odd(buffer: NDArray[np.uint8], starts: Int, ends: Int) -> tuple[Float, Bool]:
    """The same for exponents, long mantissas, nan, inf, and words that are no numbers."""
    values, valid = np.full(len(starts), np.nan), np.zeros(len(starts), np.bool_)
    if len(starts) > _FEW:
        from mapmend.io import _decimal_kernels

        _decimal_kernels.parse(buffer, starts, ends, values, valid)
    left = np.flatnonzero(~valid)
    for k, start, end in zip(left.tolist(), starts[left].tolist(), ends[left].tolist(), strict=True):
        word = buffer[start:end].tobytes()
        try:
            values[k] = float(word)
        except ValueError:
            continue
        valid[k] = b"_" not in word  # Python reads 1_000, no other program does
    return values, valid


def format_rows(
    ranges_m: NDArray[np.float32], offsets: Int, no_return_m: Float, least_decimals: int = 2
) -> list[bytes]:
    """Each scan's readings as text, a blank before each; read back as float32 they are the same to the last bit.

    ``offsets``: shape (n + 1,). ``no_return_m``: shape (n,), written (rounded up) for ``inf``; ``nan`` becomes 0.
    """
    values = ranges_m.astype(np.float64)
    ceiling = np.repeat(no_return_m, np.diff(offsets))
    none = np.isinf(values)
    seen = np.isfinite(values)
    decimals = _decimals_needed(values[seen], ranges_m[seen], least_decimals)
    values[np.isnan(values)] = 0.0
    values[none] = ceiling[none]
    whole = np.rint(values * 10.0**decimals).astype(np.int64)
    whole[none & (whole / 10.0**decimals < ceiling)] += 1
    places = max(len(str(int(whole.max(initial=0)))), decimals + 1)
    characters = np.empty((len(whole), places + 2), np.uint8)
    keep = np.ones(characters.shape, np.bool_)
    characters[:, 0] = ord(" ")
    rest = whole
    columns = [k for k in range(places + 2) if k not in (0, places + 1 - decimals)]
    characters[:, places + 1 - decimals] = ord(".")
    for column in reversed(columns):
        shorter = rest // 10
        characters[:, column] = ord("0") + (rest - 10 * shorter)
        keep[:, column] = (rest > 0) | (column >= places - decimals)
        rest = shorter
    text = characters[keep].tobytes()
    ends = np.concatenate(([0], np.cumsum(keep.sum(axis=1))))[offsets].tolist()
    return [text[a:b] for a, b in pairwise(ends)]


def _decimals_needed(values: Float, ranges_m: NDArray[np.float32], least: int) -> int:
    """The fewest decimals that keep every reading, given the float32 values as they are in memory."""
    for decimals in range(least, _MOST_DECIMALS):
        power = 10.0**decimals
        # A few readings first: most logs that need more decimals show it at once.
        for part in (slice(0, 1000), slice(None)):
            if np.any((np.rint(values[part] * power) / power).astype(np.float32) != ranges_m[part]):
                break
        else:
            return decimals
    return _MOST_DECIMALS
