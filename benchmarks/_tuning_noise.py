"""How much of a difference between two maps' M is noise: a jackknife over stretches of the trajectory.

A map's pairs are not independent: one badly placed scan contradicts many others. So one stretch of the trajectory at a
time is left out, with all pairs that touch it. The scatter of the ratio of the two M shows how different it might have
been with another drive through the same rooms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency.measure import measure_at
from mapmend.consistency.visibility import view_scans
from mapmend.graph.pose_graph import PoseGraph
from mapmend.parallel import map_in_order
from mapmend.tuning import tune as tuning
from mapmend.tuning.pair_sample import NO_DROP, PairSample

Float = NDArray[np.float64]

STRIDE = 8
"""Every n-th pair: the sample's own error is a tenth of the jackknife's."""

STRETCHES = 30


def differences(start: PoseGraph, poses: list[Float], threads: int) -> list[tuple[float, float]]:
    """M of each map over that of the first one, less 1, and the standard error by the jackknife."""
    assert start.scans is not None
    views = view_scans(start.scans, tuning.DEFAULT_CONFIG.consistency)
    sample = PairSample(views, STRIDE)
    sample.list_pairs(poses)
    pairs = sample.pairs
    stretch = np.arange(len(start)) * STRETCHES // len(start)
    touched = stretch[pairs]

    def work(pose: Float) -> Float:
        """The sum of M_ij over all pairs, and that over those of one stretch and any other, (1 + STRETCHES,)."""
        values = measure_at(views, pairs, pairs, views.lasers_at(pose), NO_DROP)[:, 1]
        of_either = np.bincount(touched[:, 0], values, STRETCHES) + np.bincount(touched[:, 1], values, STRETCHES)
        within = touched[:, 0] == touched[:, 1]
        of_both = np.bincount(touched[within, 0], values[within], STRETCHES)
        return np.concatenate(([values.sum()], values.sum() - of_either + of_both))

    sums = np.stack(map_in_order(work, poses, threads))
    ratios = sums / sums[0] - 1.0
    scatter = ((ratios[:, 1:] - ratios[:, 1:].mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    errors = np.sqrt(scatter * (STRETCHES - 1) / STRETCHES)
    return list(zip(ratios[:, 0].tolist(), errors.tolist(), strict=True))
