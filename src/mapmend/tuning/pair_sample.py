"""The sum of MC (11) over pairs of scans, for many similar maps: pairs that did not move are not measured again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency.measure import measure_at
from mapmend.consistency.views import ScanViews
from mapmend.parallel import Progress, map_in_order, no_progress
from mapmend.tuning import _kernels

Float = NDArray[np.float64]
Int = NDArray[np.int64]

PAIRS_A_PIECE = 1 << 11
SCANS_A_PIECE = 256
NO_DROP = (0, 0.0)
EVERY_PAIR = -1.0
"""The tolerance with which every pair is measured in every map."""


@dataclass(frozen=True)
class Evaluation:
    """The sums of a sample of pairs for f maps, a row each.

    ``sum_m``: (f,), the sum of M_ij over the sample, metres; ``bound_m``: (f,), how far each may be off at most for
    pairs that were not measured again. ``measured``: how many pairs were measured in total, ``asked``: how many would
    have been measured without the shortcut.
    """

    sum_m: Float
    bound_m: Float
    measured: int
    asked: int


class PairSample:
    """Every ``stride``-th pair of scans, the same pairs for all maps.

    A pair is listed when its scans' circles of view meet in any of the maps evaluated; before that, and in maps where
    they do not meet, it contributes nothing. Each pair remembers the poses at which it was last measured.
    """

    def __init__(self, views: ScanViews, stride: int) -> None:
        self.views = views
        self.stride = stride
        self.circles = view_circles(views)
        offsets = views.points.offsets
        counts = np.diff(offsets)
        far = np.concatenate(([0.0], np.cumsum(np.hypot(*views.points.xy.T))))
        self.sums = np.stack((counts.astype(np.float64), far[offsets[1:]] - far[offsets[:-1]]), axis=1)
        self.pairs = np.zeros((0, 2), np.int64)
        self.kept = np.zeros((0, 4))
        self.values = np.zeros(0)

    def evaluate(
        self,
        poses: list[Float],
        tolerance_m: float,
        *,
        threads: int = 1,
        stage: str = "measure",
        progress: Progress = no_progress,
    ) -> Evaluation:
        """The sums of maps, whose node poses (n, 3) are given; the same for any number of threads.

        ``tolerance_m``: the greatest mean bound of the pairs that are not measured again, chosen from those that moved
        least; below 0 every pair is measured in every map.
        """
        lasers = self.list_pairs(poses, threads)

        def work(begin: int) -> tuple[Float, Float, int]:
            return self._evaluate_piece(slice(begin, begin + PAIRS_A_PIECE), lasers, tolerance_m)

        begins = list(range(0, len(self.pairs), PAIRS_A_PIECE))
        parts = map_in_order(work, begins, threads, stage, progress)
        none = np.zeros(len(poses))
        return Evaluation(
            sum_m=np.sum([p[0] for p in parts], axis=0) if parts else none,
            bound_m=np.sum([p[1] for p in parts], axis=0) if parts else none,
            measured=sum(p[2] for p in parts),
            asked=len(self.pairs) * len(poses),
        )

    def list_pairs(self, poses: list[Float], threads: int = 1) -> Float:
        """Lists pairs that meet in one of the maps and are not listed yet.

        Returns the lasers in each map, (f, n, 4).
        """
        n = len(self.circles)
        lasers = np.stack([self.views.lasers_at(p) for p in poses])
        centres = np.empty((len(poses), n, 2))
        _kernels.place_circles(lasers, self.circles, centres)

        def work(begin: int) -> Int:
            first = (begin, min(begin + SCANS_A_PIECE, n))
            count = _kernels.sampled_pairs(first, self.stride, centres, self.circles, np.empty((0, 2), np.int64))
            found = np.empty((count, 2), np.int64)
            if count:
                _kernels.sampled_pairs(first, self.stride, centres, self.circles, found)
            return found

        found = np.concatenate(map_in_order(work, list(range(0, n, SCANS_A_PIECE)), threads) or [self.pairs])
        known = self.pairs[:, 0] * n + self.pairs[:, 1]
        found = found[~np.isin(found[:, 0] * n + found[:, 1], known)]
        self.pairs = np.concatenate((self.pairs, found))
        self.kept = np.concatenate((self.kept, np.full((len(found), 4), np.nan)))
        self.values = np.concatenate((self.values, np.zeros(len(found))))
        return lasers

    def _evaluate_piece(self, piece: slice, lasers: Float, tolerance_m: float) -> tuple[Float, Float, int]:
        """Sums and bounds of some pairs in all maps, one map after the other, and how many were measured."""
        pairs, kept, values = self.pairs[piece], self.kept[piece], self.values[piece]
        now, bounds = np.empty((len(pairs), 4)), np.empty(len(pairs))
        maps = len(lasers)
        sums, off, measured = np.zeros(maps), np.zeros(maps), 0
        for f in range(maps):
            _kernels.change_bounds(pairs, lasers[f], self.sums, kept, now, bounds)
            rows = _worth_measuring(bounds, tolerance_m)
            if len(rows):
                chosen = pairs[rows]
                values[rows] = measure_at(self.views, chosen, chosen, lasers[f], NO_DROP)[:, 1]
                kept[rows] = now[rows]
                bounds[rows] = 0.0
            sums[f], off[f] = values.sum(), bounds.sum()
            measured += len(rows)
        return sums, off, measured


def _worth_measuring(bounds: Float, tolerance_m: float) -> Int:
    """The rows to measure: all except those with the least bounds whose mean over all rows is within the tolerance."""
    if tolerance_m < 0.0:
        return np.arange(len(bounds))
    order = np.argsort(bounds, kind="stable")
    few = int(np.searchsorted(np.cumsum(bounds[order]), tolerance_m * len(bounds), side="right"))
    return np.sort(order[few:])


def view_circles(views: ScanViews) -> Float:
    """A circle around all that each scan sees, in the laser's frame: x, y, radius, (n, 3); without a scan, radius
    -1."""
    n, corners, offsets = len(views), views.polygons.corners, views.polygons.offsets
    circles = np.tile((0.0, 0.0, -1.0), (n, 1))
    for i in np.flatnonzero(np.diff(offsets) > 0):
        ends = corners[:2, offsets[i] : offsets[i + 1]].T
        low, high = np.minimum(ends.min(axis=0), 0.0), np.maximum(ends.max(axis=0), 0.0)
        middle = (low + high) / 2.0
        far = np.hypot(*(ends - middle).T).max()
        # Slightly larger, so that rounding never leaves a point out.
        circles[i] = (*middle, max(far, float(np.hypot(*middle))) * (1.0 + 1e-9) + 1e-9)
    return circles
