"""The least M(phi) of a dense sweep, over all pairs of scans, without measuring every value over all of them.

All values are solved. They are measured in a small sample of the pairs, the same pairs for all; the remaining values in
a sample four times larger, and so on; the last ones over all pairs. A value is removed when the sample shows that it
cannot be more than MARGIN below the best one: its difference from the best, pair by pair, minus SURE standard errors,
is above -MARGIN of M. So the least M found is at most MARGIN above the true minimum. The standard error is that of a
simple random sample of the pairs' differences. The sample is every n-th partner of each scan, with another first
partner for each scan. This is at least as even as a random sample, because neighbouring scans see nearly the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency.measure import measure_at
from mapmend.consistency.views import ScanViews
from mapmend.consistency.visibility import view_scans
from mapmend.graph.pose_graph import PoseGraph
from mapmend.parallel import map_in_order
from mapmend.tuning import tune as tuning
from mapmend.tuning.pair_sample import NO_DROP, Evaluation, PairSample
from mapmend.tuning.search import LARGEST_ROOT
from mapmend.tuning.solutions import Solution, solve

Float = NDArray[np.float64]

VALUES = 400
MARGIN, SURE = 0.002, 4.0
FIRST_STRIDE, NARROWING, FEW = 128, 4, 2
"""The first sample, the factor to each next one, and the number of remaining values that are measured over all
pairs."""

WHOLE_WITHIN = 0.001
"""With ``whole`` a pair is not measured again whose motion can't have changed M by more than this, all together."""


@dataclass(frozen=True)
class Differences:
    """Sums over all pairs as a sample has them, less the best one's, and their standard errors, metres: (f,) each."""

    best: int
    sum_m: float
    less_m: Float
    error_m: Float


def sweep(start: PoseGraph, threads: int, whole: bool = False) -> tuple[dict[str, Any], list[Solution]]:
    """The least of VALUES values of phi, and how many values were in each sample; all solutions.

    ``whole``: beside it, every value over all pairs, and how far the samples were off.
    """
    roots = np.linspace(0.0, LARGEST_ROOT, VALUES)
    solved = solve(start, "dcs", (roots**2).tolist(), threads=threads)
    found = [s for s in solved if isinstance(s, Solution)]
    assert start.scans is not None
    views = view_scans(start.scans, tuning.DEFAULT_CONFIG.consistency)
    left, stages, errors = np.arange(len(found)), [], []
    stride = FIRST_STRIDE
    while len(left) > FEW and stride > 1:
        seen = differences(views, [found[k].poses for k in left], stride, threads)
        stages.append([stride, len(left)])
        errors.append((left, seen))
        stays = seen.less_m - SURE * seen.error_m <= -MARGIN * seen.sum_m
        stays[seen.best] = True
        left = left[stays]
        stride //= NARROWING
    sums = {int(k): sum_over_all(views, found[k].poses, threads) for k in left}
    least = min(sums, key=lambda k: sums[k])
    row = {"sweep_phi": found[least].phi, "sweep_sum_m": sums[least], "stages": [*stages, [1, len(left)]]}
    if whole:
        whole_m = over_all(views, [s.poses for s in found], sums[least], threads)
        row |= {"whole_phi": found[int(np.argmin(whole_m.sum_m))].phi, "whole_sum_m": float(whole_m.sum_m.min())}
        row |= {"whole_curve": whole_m.sum_m.tolist(), "whole_bound": float(whole_m.bound_m.max()) / sums[least]}
        row["farthest"] = [farthest(stage, whole_m.sum_m) for stage in errors]
    return row, found


def differences(views: ScanViews, poses: list[Float], stride: int, threads: int) -> Differences:
    """Every map's M over every ``stride``-th pair beside the best one's, as sums over all pairs."""
    sample = PairSample(views, stride)
    sample.list_pairs(poses)
    pairs = sample.pairs

    def work(pose: Float) -> Float:
        return measure_at(views, pairs, pairs, views.lasers_at(pose), NO_DROP)[:, 1].astype(np.float32)

    values = np.stack(map_in_order(work, poses, threads))
    sums = values.sum(axis=1, dtype=np.float64)
    best = int(np.argmin(sums))
    apart = values - values[best]
    spread = apart.std(axis=1, dtype=np.float64) * np.sqrt(len(pairs) * (1.0 - 1.0 / stride))
    return Differences(best, stride * float(sums[best]), stride * (sums - sums[best]), stride * spread)


def farthest(stage: tuple[NDArray[np.int64], Differences], sums_m: Float) -> float:
    """By how many standard errors a sample's difference was off at most, where it stands for more than MARGIN of M."""
    left, seen = stage
    true = sums_m[left] - sums_m[left[seen.best]]
    matters = seen.error_m > MARGIN / SURE * seen.sum_m
    return float(np.max(np.abs(seen.less_m - true)[matters] / seen.error_m[matters])) if matters.any() else 0.0


def over_all(views: ScanViews, poses: list[Float], least_m: float, threads: int) -> Evaluation:
    """The sum over all pairs of every map, but for what moves can't have changed by more than WHOLE_WITHIN of M."""
    sample = PairSample(views, 1)
    sample.list_pairs(poses, threads)
    return sample.evaluate(poses, WHOLE_WITHIN * least_m / len(sample.pairs), threads=threads)


def sum_over_all(views: ScanViews, poses: Float, threads: int) -> float:
    """The sum of M_ij over all pairs of scans of a map, metres."""
    measure_m, overlapping = tuning.average_measure(views.placed(poses), threads=threads)
    return measure_m * overlapping
