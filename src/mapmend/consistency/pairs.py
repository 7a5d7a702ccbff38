"""Which scans overlap: all pairs with overlapping bounding boxes, found by a uniform grid."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency import _overlap_kernels

Float = NDArray[np.float64]
Int = NDArray[np.int64]

MOST_CELLS_A_SCAN = 8
"""If the scans are spread over more cells than this, the cells grow: memory follows the scans, not the distances."""


@dataclass(frozen=True)
class Overlaps:
    """All overlapping pairs (i, j), i < j, of n scans: ``counts`` (n,): how many begin with each i."""

    boxes: Float
    cells: Int
    order: Int
    starts: Int
    width: int
    counts: Int

    @property
    def total(self) -> int:
        return int(self.counts.sum())

    def pieces(self, pairs_each: int) -> list[tuple[int, int]]:
        """Ranges of rows (first, end) with about this many pairs each: the work of one thread at a time."""
        piece = np.cumsum(self.counts) // max(pairs_each, 1)
        cuts = np.flatnonzero(np.diff(piece)) + 1
        edges = [0, *cuts.tolist(), len(self.counts)]
        return [(a, b) for a, b in pairwise(edges) if self.counts[a:b].any()]

    def listed(self, first: int, last: int) -> Int:
        """The pairs of the scans from ``first`` to before ``last``, (k, 2), in order."""
        pairs = np.empty((int(self.counts[first:last].sum()), 2), np.int64)
        grid = (self.order, self.starts, self.width)
        _overlap_kernels.list_overlapping(first, last, self.boxes, self.cells, grid, self.counts, pairs)
        return pairs


def find_overlaps(boxes: Float) -> Overlaps:
    """The pairs of boxes (n, 4), low x, low y, high x, high y, that overlap or touch; low above high is no box."""
    n = len(boxes)
    filled = boxes[:, 0] <= boxes[:, 2]
    counts, cells = np.zeros(n, np.int64), np.zeros(n, np.int64)
    if not filled.any():
        return Overlaps(boxes, cells, np.zeros(0, np.int64), np.zeros(2, np.int64), 1, counts)
    low, size = boxes[filled, :2].min(axis=0), 1e-6
    size = max(size, float((boxes[filled, 2:] - boxes[filled, :2]).max()) * (1.0 + 1e-9))
    span = boxes[filled, :2].max(axis=0) - low
    while float(np.prod(np.floor(span / size) + 1.0)) > MOST_CELLS_A_SCAN * n + 1000:
        size *= 2.0
    columns, rows = (np.floor(span / size).astype(np.int64) + 1).tolist()
    place = np.floor((boxes[filled, :2] - low) / size).astype(np.int64)
    cells[filled] = place[:, 1] * columns + place[:, 0]
    which = np.flatnonzero(filled)
    order = which[np.argsort(cells[which], kind="stable")]
    starts = np.searchsorted(cells[order], np.arange(rows * columns + 1))
    _overlap_kernels.count_overlapping(boxes, cells, order, starts, columns, counts)
    return Overlaps(boxes, cells, order, starts, columns, counts)
