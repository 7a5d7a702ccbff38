"""The kernel that reads decimal numbers of up to nineteen digits, with or without an exponent, as ``float`` does.

The digits are a whole number below 2**63, and powers of ten up to 10**22 are doubles. Product or quotient of the two
are computed to twice a double's precision (Dekker 1971), then rounded once. If the last step is too near to a tie to
decide how ``float`` would round, or if a word is not of this kind, it is left to ``float``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

MOST_DIGITS = np.uint64(10**18 - 1)  # with one more digit, this still fits
POWERS = np.array([float(10**k) for k in range(23)])
SPLITTER = float(2**27 + 1)
NEAR_TIE = 1e-9  # of the last place; the error of the doubled precision is 1e-15 of it


@kernel(inline="always")
def product(a: float, b: float) -> tuple[float, float]:
    """``a * b`` rounded, and the rounding error."""
    high = a * b
    split = SPLITTER * a
    a1 = split - (split - a)
    a2 = a - a1
    split = SPLITTER * b
    b1 = split - (split - b)
    b2 = b - b1
    return high, ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2


@kernel(inline="always")
def scaled(digits: np.uint64, exponent: int) -> tuple[float, bool]:
    """``digits * 10**exponent``, and whether the rounding is certainly right."""
    high = np.float64(digits)
    low = np.float64(np.int64(digits - np.uint64(high)))
    if exponent < 0:
        power = POWERS[-exponent]
        near = high / power
        back, left_out = product(near, power)
        rest = (((high - back) - left_out) + low) / power
    else:
        power = POWERS[exponent]
        near, left_out = product(high, power)
        rest = left_out + low * power
    value = near + rest
    place = np.nextafter(value, np.inf) - value
    off = abs(rest - (value - near)) / place
    # Below a power of two, the spacing of doubles is half as wide.
    return value, abs(off - 0.5) > NEAR_TIE and abs(off - 0.25) > NEAR_TIE


@kernel
def parse(
    buffer: NDArray[np.uint8],
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    values: NDArray[np.float64],
    valid: NDArray[np.bool_],
) -> None:
    """Fills ``values`` and sets ``valid`` for the words ``buffer[starts[k] : ends[k]]`` that it can read."""
    for k in range(len(starts)):
        p, end = starts[k], ends[k]
        negative = buffer[p] == ord("-")
        p += negative or buffer[p] == ord("+")
        digits, exponent, count, has_dot = np.uint64(0), 0, 0, False
        while p < end and digits <= MOST_DIGITS:
            character = buffer[p]
            if ord("0") <= character <= ord("9"):
                digits = np.uint64(10) * digits + np.uint64(character - ord("0"))
                count += 1
                exponent -= has_dot
            elif character == ord(".") and not has_dot:
                has_dot = True
            else:
                break
            p += 1
        if p + 1 < end and (buffer[p] == ord("e") or buffer[p] == ord("E")):
            p += 1
            sign = -1 if buffer[p] == ord("-") else 1
            p += buffer[p] == ord("-") or buffer[p] == ord("+")
            power, first = 0, p
            while p < end and ord("0") <= buffer[p] <= ord("9") and power < 1000:
                power = 10 * power + buffer[p] - ord("0")
                p += 1
            exponent += sign * power
            count *= p > first
        if p == end and count > 0 and abs(exponent) < len(POWERS):
            value, valid[k] = scaled(digits, exponent)
            values[k] = -value if negative else value
