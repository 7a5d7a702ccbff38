"""The suspect loop edges: those whose measurement makes the scans around their ends contradict each other.

The effect of a wrong loop on the optimized map is spread over many scans, and it opens true loops. So each edge is
tested alone: the scans around its two nodes are placed by the odometry from these nodes on, and by the measurement of
the edge between the two. Their pairs are tested like those of the map.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.config import ConsistencyConfig
from mapmend.consistency.cascade import standardized
from mapmend.consistency.measure import measure_at
from mapmend.consistency.scale import OdometryMap, pair_scales
from mapmend.consistency.views import ScanViews
from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.parallel import Progress, map_in_order, no_progress

Float = NDArray[np.float64]
Int = NDArray[np.int64]

NEIGHBOURHOOD = np.arange(-9, 10, 3)
"""The scans that represent an end of an edge: this many before and after it along the odometry."""

MOST_TELLING = 12.0
"""A single pair counts with at most this many standard deviations."""

EDGES_A_PIECE = 64


def suspect_loops(
    graph: PoseGraph,
    views: ScanViews,
    laid: OdometryMap,
    scales: Float,
    config: ConsistencyConfig,
    *,
    threads: int = 1,
    progress: Progress = no_progress,
) -> tuple[Int, Float]:
    """The loop edges, the most suspect first, and the evidence against each: rows of edges, (l,), and (l,).

    The evidence against an edge is the sum of the standard deviations by which its pairs fail, over the root of their
    number. ``scales``: (n,), metres, those of the map's tests, inflation included.
    """
    loops = np.flatnonzero(graph.is_loop)
    order = np.lexsort((laid.position, laid.chain))
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))

    def work(piece: Int) -> Float:
        return np.array([_against(edge) for edge in piece])

    def _against(edge: int) -> float:
        i, j = graph.edges[edge].tolist()
        first, second = (_around(node, laid, order, place) for node in (i, j))
        poses = (
            se2.between(laid.poses[i], laid.poses[first]),
            se2.compose(graph.measurements[edge], se2.between(laid.poses[j], laid.poses[second])),
        )
        rows = np.concatenate((first, second))
        lasers = views.lasers_at(np.concatenate(poses), rows)
        a, b = np.repeat(np.arange(len(first)), len(second)), np.tile(np.arange(len(second)), len(first))
        stands = np.stack((a, b + len(first)), axis=1)
        pairs = rows[stands]
        measured = measure_at(views, pairs, stands, lasers, (config.drop_points, config.drop_share))
        enough = (measured[:, 2] >= config.min_points) & (pairs[:, 0] != pairs[:, 1])
        if not enough.any():
            return 0.0
        scale = pair_scales(scales, pairs[enough], config)
        psi = standardized(measured[enough, 3], measured[enough, 2], scale)
        return float(np.clip(psi, 0.0, MOST_TELLING).sum() / np.sqrt(len(psi)))

    pieces = [loops[k : k + EDGES_A_PIECE] for k in range(0, len(loops), EDGES_A_PIECE)]
    parts = map_in_order(work, pieces, threads, "loops", progress)
    against = np.concatenate(parts) if parts else np.zeros(0)
    by_weight = np.argsort(-against, kind="stable")
    return loops[by_weight], against[by_weight]


def _around(node: int, laid: OdometryMap, order: Int, place: Int) -> Int:
    """The node's neighbourhood along its chain."""
    near = place[node] + NEIGHBOURHOOD
    near = order[near[(near >= 0) & (near < len(order))]]
    return near[laid.chain[near] == laid.chain[node]]
