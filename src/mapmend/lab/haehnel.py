"""The rival that MC compares with: the log-likelihood of a scan over the occupancy grid of another.

Hähnel, Burgard, Wegbreit, Thrun, "Towards lazy data association in SLAM" (ISRR 2003), as MC sections II and VI use it:
a map is inconsistent where its log-likelihood is below a threshold. One scan fills a grid. An end point of the other
scan is unlikely on a cell that was seen free, likely on a cell that was seen occupied, and not counted elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency.pairs import find_overlaps
from mapmend.consistency.views import PlacedViews
from mapmend.lab import _haehnel_kernels
from mapmend.parallel import Progress, map_in_order, no_progress

Float = NDArray[np.float64]
Int = NDArray[np.int64]

CELL_M = 0.1
OCCUPIED_PROBABILITY, FREE_PROBABILITY = 0.9, 0.1
"""The values of a cell that the grid's scan saw occupied, or free."""

PAIRS_A_PIECE = 1 << 14


@dataclass(frozen=True)
class Likelihoods:
    """By overlapping pair (i, j), i < j: ``pairs`` (k, 2), the mean log-likelihood of both scans' end points on
    cells the other has seen, ``mean`` (k,), and their number, ``points`` (k,).
    """

    pairs: Int
    mean: Float
    points: Int


def log_likelihoods(views: PlacedViews, threads: int = 1, progress: Progress = no_progress) -> Likelihoods:
    """The log-likelihoods of all pairs whose bounding boxes overlap; the same for any number of threads."""
    overlaps = find_overlaps(views.boxes())
    pieces = overlaps.pieces(PAIRS_A_PIECE)

    def work(piece: tuple[int, int]) -> tuple[Int, Int]:
        pairs = overlaps.listed(*piece)
        counts = count_over_grids(views, pairs)
        turned = np.lexsort((pairs[:, 0], pairs[:, 1]))
        counts[turned] += count_over_grids(views, pairs[turned][:, ::-1].copy())
        return pairs, counts

    parts = map_in_order(work, pieces, threads, "likelihoods", progress)
    pairs = np.concatenate([p for p, _ in parts]) if parts else np.zeros((0, 2), np.int64)
    counts = np.concatenate([c for _, c in parts]) if parts else np.zeros((0, 2), np.int64)
    points = counts.sum(axis=1)
    total = counts[:, 0] * np.log(FREE_PROBABILITY) + counts[:, 1] * np.log(OCCUPIED_PROBABILITY)
    return Likelihoods(pairs, total / np.maximum(points, 1), points)


def count_over_grids(views: PlacedViews, pairs: Int) -> Int:
    """End points of each pair's second scan on free and on occupied cells of its first, (k, 2); sorted by the first."""
    seen = views.scans
    reach = float(np.hypot(*seen.polygons.corners[:2]).max(initial=0.0))
    size = np.array([CELL_M, np.ceil(reach / CELL_M) + 1.0])
    counts = np.zeros((len(pairs), 2), np.int64)
    _haehnel_kernels.count_over_grids(pairs, seen.polygons, seen.points, views.lasers, seen.beams, size, counts)
    return counts
