"""The pairwise inconsistency measure, MC (1) and (2), of all overlapping pairs of scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency import _kernels
from mapmend.consistency.pairs import find_overlaps
from mapmend.consistency.views import PlacedViews, ScanViews
from mapmend.parallel import Progress, map_in_order, no_progress

Float = NDArray[np.float64]
Int = NDArray[np.int64]

PAIRS_A_PIECE = 1 << 14


@dataclass(frozen=True)
class PairMeasures:
    """The measured pairs of n scans, a row each, i < j, in order: the entries of the sparse Psi.

    ``pairs``: (k, 2). ``points``: (k,), n_ij; ``measure_m``: (k,), M_ij. ``kept``, ``kept_m``: the same without each
    pair's largest depths. ``overlapping``: how many pairs overlap, with those that have too few points.
    """

    pairs: Int
    points: Int
    measure_m: Float
    kept: Int
    kept_m: Float
    overlapping: int


def measure_pairs(
    views: PlacedViews,
    fewest: int = 0,
    drop: tuple[int, float] = (0, 0.0),
    threads: int = 1,
    progress: Progress = no_progress,
) -> PairMeasures:
    """Measures all pairs whose bounding boxes overlap; the same for any number of threads.

    Pairs with fewer than ``fewest`` inconsistent points are counted and left out: memory follows those that are kept.
    ``drop``: the least number of a pair's largest depths that are left out of ``kept_m``, and the least share of them.
    """
    overlaps = find_overlaps(views.boxes())

    def work(piece: tuple[int, int]) -> tuple[Int, Float]:
        pairs = overlaps.listed(*piece)
        measured = measure(views, pairs, drop)
        enough = measured[:, 0] >= fewest
        return pairs[enough], measured[enough]

    parts = map_in_order(work, overlaps.pieces(PAIRS_A_PIECE), threads, "compare", progress)
    pairs = np.concatenate([p for p, _ in parts]) if parts else np.zeros((0, 2), np.int64)
    measured = np.concatenate([m for _, m in parts]) if parts else np.zeros((0, 4))
    counts = measured[:, [0, 2]].astype(np.int64)
    return PairMeasures(pairs, counts[:, 0], measured[:, 1], counts[:, 1], measured[:, 3], overlaps.total)


def measure(views: PlacedViews, pairs: Int, drop: tuple[int, float] = (0, 0.0)) -> Float:
    """n_ij, M_ij, and both without the largest depths, of pairs (k, 2) of scans: (k, 4)."""
    return measure_at(views.scans, pairs, pairs, views.lasers, drop)


def measure_at(views: ScanViews, pairs: Int, stands: Int, lasers: Float, drop: tuple[int, float]) -> Float:
    """The same for scans whose laser poses are the rows ``stands``, (k, 2), of ``lasers``, (s, 4)."""
    measured = np.zeros((len(pairs), 4))
    dropped = _kernels.Drop(int(drop[0]), float(drop[1]))
    _kernels.measure_pairs(pairs, stands, views.polygons, views.points, lasers, views.beams, dropped, measured)
    return measured
