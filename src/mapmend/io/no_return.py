"""Which readings of a laser mean no return."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# A SICK laser in centimetre mode reports 13 bits, of which 8183 (beyond the maximum) to 8191 (invalid) are codes.
SICK_FIRST_CODE_M = 81.83
SICK_LAST_CODE_M = 81.91
SICK_MAX_RANGE_M = 80.0  # the greatest range in its data sheet

_EDGE = 0.005  # half a centimetre: the readings' own resolution, and the width of a bin to either side
_LEAST_READINGS = 1000
_LEAST_COUNT = 30
_TOO_OFTEN = 20.0  # times as often as other far readings
_CODES_APART_BINS = 6  # lasers with 5 cm steps report their codes 5 cm apart
_MOST_SHARE = 0.9  # a value that nearly all beams read is rather a wall
_FAR = 0.98  # the value for "no return" is within this share of the largest reading


def no_return_limit_m(ranges_m: NDArray[np.float32], claimed_max_m: float | None) -> float:
    """The least reading that is no return, in metres, from all the readings of one laser, shape (total,).

    The lowest of: the limit that the file claims; the codes of a SICK laser, if no reading is beyond them; the largest
    reading, if it and its neighbours occur far too often (`frequent_maximum_m`); 80 m if none of these gives a limit.
    """
    limits = [] if claimed_max_m is None else [claimed_max_m]
    finite = ranges_m[np.isfinite(ranges_m)]
    largest = float(finite.max(initial=0.0))
    if SICK_FIRST_CODE_M - _EDGE <= largest <= SICK_LAST_CODE_M + _EDGE:
        limits.append(SICK_FIRST_CODE_M)
    frequent = frequent_maximum_m(finite)
    if frequent is not None:
        limits.append(frequent)
    if not limits:
        limits.append(SICK_MAX_RANGE_M if largest <= SICK_LAST_CODE_M + _EDGE else np.nextafter(largest, np.inf))
    return float(min(limits))


def frequent_maximum_m(finite_m: NDArray[np.float32]) -> float | None:
    """The least reading of the cluster at the top of the histogram, if no wall explains it, or None.

    In centimetre bins: the fullest bin within 2 % of the largest reading must hold at least 30 readings and 20 times
    the median of the occupied bins in the upper half (or be the only one there), but not nine tenths of all. Full bins
    up to 6 cm below belong to it, and the bin next to the lowest of these.
    """
    if len(finite_m) < _LEAST_READINGS:
        return None
    far_m = finite_m[finite_m >= 0.45 * min(float(finite_m.max()), 1000.0)]
    bins = np.bincount(np.rint(np.minimum(far_m, 1000.0) * np.float32(100.0)).astype(np.int32))
    last = len(bins) - 1
    top = int(_FAR * last)
    fullest = top + int(np.argmax(bins[top:]))
    others = bins[last // 2 : fullest - 2 * _CODES_APART_BINS]
    others = others[others > 0]
    typical = float(np.median(others)) if len(others) else 1.0
    enough = max(_LEAST_COUNT, _TOO_OFTEN * typical)
    if bins[fullest] < enough or bins[fullest] > _MOST_SHARE * len(finite_m):
        return None
    lowest = fullest
    while (below := _full_bin_below(bins, lowest, enough)) is not None:
        lowest = below
    if 0 < bins[lowest - 1] < bins[lowest]:
        lowest -= 1
    return float(np.round(far_m[far_m >= np.float32(lowest / 100.0 - _EDGE)].min().astype(np.float64), 4))


def _full_bin_below(bins: NDArray[np.int64], lowest: int, enough: float) -> int | None:
    """The next bin below, at most the distance of the codes away, that is far too full as well."""
    for k in range(lowest - 1, max(lowest - 1 - _CODES_APART_BINS, 0), -1):
        if bins[k] >= enough:
            return k
    return None
