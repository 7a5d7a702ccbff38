"""Where a map is wrong: regions of scans that contradict each other, the points that do, and loop edges to suspect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency import _kernels
from mapmend.consistency.cascade import PairTests, ScanTests
from mapmend.consistency.measure import kernel_views
from mapmend.consistency.scale import OdometryMap
from mapmend.consistency.visibility import Views
from mapmend.graph.pose_graph import PoseGraph

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

DEEP = 2.0
"""A point contradicts another scan where it lies this many of the pair's scales deep in its free space."""

NEIGHBOURHOOD = 8
"""The scans so many places before and behind a loop edge's ends tell whether it is right."""

MOST_TELLING = 12.0
"""No single pair tells more than this many standard deviations."""


@dataclass(frozen=True)
class Region:
    """Failed scans that contradict each other. ``place_m``: the middle of the contradicting points; ``size_m``: the
    larger side of the box that holds most of them. ``scans``: node rows; ``loops``: rows of edges that end among them,
    the most suspect first. ``failures``: failed pairs of these scans.
    """

    place_m: tuple[float, float]
    size_m: float
    scans: Int
    loops: Int
    failures: int


def contradicting_points(views: Views, tests: PairTests, scans: ScanTests, scales: Float) -> Bool:
    """The end points, (returns,), that lie deep in the free space of a scan in a failed pair of two failed scans.

    ``scales``: (k,), metres, those of the tested pairs.
    """
    chosen = tests.failed & scans.failed[tests.pairs].any(axis=1)
    marks = np.zeros(len(views.points), np.int64)
    least = DEEP * scales[chosen]
    _kernels.mark_points(tests.pairs[chosen], least, *kernel_views(views), marks)
    return np.asarray(marks > 0)


def suspect_loops(graph: PoseGraph, laid: OdometryMap, tests: PairTests) -> tuple[Int, Float]:
    """The loop edges, the most suspect first, and what speaks against each: rows of edges, (l,), and (l,).

    A false loop lays two places on each other, and the scans around its two ends contradict each other. What speaks
    against it is how far these pairs exceed what agreeing scans show, in all, over the root of their number.
    """
    loops = np.flatnonzero(graph.is_loop)
    excess = np.clip(tests.psi, 0.0, MOST_TELLING)
    rows = _pair_table(tests, len(graph))
    places = _places(laid)
    against = np.zeros(len(loops))
    for k, edge in enumerate(loops):
        around = [_around(node, laid, places) for node in graph.edges[edge]]
        between = _pairs_between(rows, around[0], around[1])
        if len(between):
            against[k] = excess[between].sum() / np.sqrt(len(between))
    order = np.argsort(-against, kind="stable")
    return loops[order], against[order]


def find_regions(
    graph: PoseGraph, views: Views, tests: PairTests, scans: ScanTests, *, points: Bool, suspects: Int
) -> list[Region]:
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
    owner = np.repeat(np.arange(n), np.diff(views.point_offsets))
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
        found.append(Region((float(middle[0]), float(middle[1])), float((high - low).max()), rows, loops, failures))
    return sorted(found, key=lambda region: -region.failures)


@dataclass(frozen=True)
class _PairTable:
    """The tested pairs sorted by their names, to be found again."""

    names: Int
    order: Int
    nodes: int


def _pair_table(tests: PairTests, nodes: int) -> _PairTable:
    names = tests.pairs[:, 0] * nodes + tests.pairs[:, 1]
    order = np.argsort(names, kind="stable")
    return _PairTable(names[order], order, nodes)


def _pairs_between(table: _PairTable, first: Int, second: Int) -> Int:
    """Rows of the tested pairs between two groups of nodes."""
    a, b = np.repeat(first, len(second)), np.tile(second, len(first))
    names = np.unique(np.minimum(a, b)[a != b] * table.nodes + np.maximum(a, b)[a != b])
    place = np.minimum(np.searchsorted(table.names, names), max(len(table.names) - 1, 0))
    if not len(table.names):
        return np.zeros(0, np.int64)
    return table.order[place[table.names[place] == names]]


def _places(laid: OdometryMap) -> Int:
    """The nodes along the odometry, chain after chain."""
    return np.lexsort((laid.position, laid.chain))


def _around(node: int, laid: OdometryMap, places: Int) -> Int:
    """The node and its neighbours along the odometry."""
    row = int(np.flatnonzero(places == node)[0])
    near = places[max(row - NEIGHBOURHOOD, 0) : row + NEIGHBOURHOOD + 1]
    return near[laid.chain[near] == laid.chain[node]]
