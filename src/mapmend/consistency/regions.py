"""Where a map is wrong: regions of scans that contradict each other, and the points that do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency import _kernels
from mapmend.consistency.cascade import PairTests, ScanTests
from mapmend.consistency.views import PlacedViews
from mapmend.graph.pose_graph import PoseGraph

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

DEEP = 2.0
"""A point contradicts another scan if it is at least this many of the pair's scales deep in its free space."""


@dataclass(frozen=True)
class InconsistentRegion:
    """Failed scans that contradict each other. ``place_m``: the middle of the contradicting points; ``size_m``: the
    larger side of the box that holds most of them. ``scans``: node rows; ``loops``: rows of edges that end among them,
    the most suspect first. ``failures``: failed pairs of these scans.
    """

    place_m: tuple[float, float]
    size_m: float
    scans: Int
    loops: Int
    failures: int


def contradicting_points(views: PlacedViews, tests: PairTests, scans: ScanTests, scales: Float) -> Bool:
    """The end points, (returns,), that are deep in the free space of the other scan of a failed pair.

    Only pairs with a failed scan count; the other scan need not have failed, because a scan may fail by contradicting
    many good ones. ``scales``: (k,), metres, those of the tested pairs.
    """
    seen, chosen = views.scans, tests.failed & scans.failed[tests.pairs].any(axis=1)
    marks = np.zeros(len(seen.points.xy), np.int64)
    least = DEEP * scales[chosen]
    _kernels.mark_points(tests.pairs[chosen], least, seen.polygons, seen.points, views.lasers, seen.beams, marks)
    return np.asarray(marks > 0)


def find_regions(
    graph: PoseGraph, views: PlacedViews, tests: PairTests, scans: ScanTests, *, points: Bool, suspects: Int
) -> list[InconsistentRegion]:
    """The regions of failed scans, those with the most failed pairs first.

    ``points``: (returns,), those that contradict; ``suspects``: rows of loop edges, in the order to list them.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    chosen = tests.failed & scans.failed[tests.pairs].all(axis=1)
    a, b = tests.pairs[chosen].T
    n = len(graph)
    _, label = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)
    in_map = views.points_in_map()
    owner = np.repeat(np.arange(n), np.diff(views.scans.points.offsets))
    found = []
    for number in np.unique(label[scans.failed]):
        rows = np.flatnonzero((label == number) & scans.failed)
        is_here = np.zeros(n, np.bool_)
        is_here[rows] = True
        mine = in_map[points & is_here[owner]]
        if not len(mine):
            mine = graph.poses[rows, :2]
        low, middle, high = np.quantile(mine, (0.1, 0.5, 0.9), axis=0)
        loops = suspects[is_here[graph.edges[suspects]].any(axis=1)]
        failures = int(np.count_nonzero(tests.failed & is_here[tests.pairs].any(axis=1)))
        found.append(
            InconsistentRegion((float(middle[0]), float(middle[1])), float((high - low).max()), rows, loops, failures)
        )
    return sorted(found, key=lambda region: -region.failures)
