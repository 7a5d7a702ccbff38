"""How inconsistent scans are that agree: a scale for each scan, MC section IV-C.

The map of the odometry edges alone, laid end to end, is right over short paths. The inconsistency of neighbouring scans
in it is the effect of noise, sampling and matching on scans that agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import ConsistencyConfig
from mapmend.consistency.measure import measure
from mapmend.consistency.views import ScanViews
from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.parallel import Progress, map_in_order, no_progress

Float = NDArray[np.float64]
Int = NDArray[np.int64]

HALF_NORMAL_MEAN = float(np.sqrt(2.0 / np.pi))
HALF_NORMAL_STD = float(np.sqrt(1.0 - 2.0 / np.pi))
"""Of a half-normal distribution with scale 1, MC (3)."""

PAIRS_A_PIECE = 1 << 13


@dataclass(frozen=True)
class OdometryMap:
    """The odometry edges laid end to end: ``poses`` (n, 3), from each chain's first node on, which stays in its place.

    ``chain``: (n,), which chain a node is in; ``position``: (n,), its position in the chain; ``way_m``: (n,), the
    length of the path to it.
    """

    poses: Float
    chain: Int
    position: Int
    way_m: Float

    def neighbours(self, reach: int, reach_m: float) -> Int:
        """Pairs (k, 2) of nodes up to ``reach`` places and ``reach_m`` of path apart in one chain, lower row first."""
        order = np.lexsort((self.position, self.chain))
        pairs = []
        for step in range(1, min(reach, len(order) - 1) + 1):
            first, second = order[:-step], order[step:]
            together = self.chain[first] == self.chain[second]
            together &= np.abs(self.way_m[second] - self.way_m[first]) <= reach_m
            pairs.append(np.stack((first[together], second[together]), axis=1))
        found = np.concatenate(pairs) if pairs else np.zeros((0, 2), np.int64)
        return np.sort(found, axis=1)

    def within(self, pairs: Int, reach_m: float) -> NDArray[np.bool_]:
        """Which of the pairs (k, 2) are in one chain and up to ``reach_m`` of path apart."""
        i, j = pairs.T
        return np.asarray((self.chain[i] == self.chain[j]) & (np.abs(self.way_m[i] - self.way_m[j]) <= reach_m))


def odometry_map(graph: PoseGraph) -> OdometryMap:
    """The graph's odometry-only map; edges may point backwards, and there may be several chains.

    Odometry edges over several nodes are ignored if there are edges between neighbours: they add no measurement
    (``scan_graph.chains``).
    """
    n = len(graph)
    steps: list[list[tuple[int, Float]]] = [[] for _ in range(n)]
    used = ~graph.is_loop
    joins_neighbours = np.abs(np.diff(graph.edges, axis=1)[:, 0]) == 1
    joins_neighbours |= np.abs(np.diff(graph.ids[graph.edges], axis=1)[:, 0]) == 1
    if np.any(used & joins_neighbours):
        used &= joins_neighbours
    for (i, j), measurement in zip(graph.edges[used].tolist(), graph.measurements[used], strict=True):
        steps[i].append((j, measurement))
        steps[j].append((i, se2.inverse(measurement)))
    poses = graph.poses.astype(np.float64).copy()
    chain, position, way_m = np.full(n, -1, np.int64), np.zeros(n, np.int64), np.zeros(n)
    for start in range(n):
        if chain[start] >= 0:
            continue
        chain[start] = start
        waiting = [start]
        for node in waiting:
            for other, step in steps[node]:
                if chain[other] < 0:
                    chain[other], position[other] = start, position[node] + 1
                    way_m[other] = way_m[node] + np.hypot(step[0], step[1])
                    poses[other] = se2.compose(poses[node], step)
                    waiting.append(other)
    return OdometryMap(poses, chain, position, way_m)


def implied_scale(measure_m: Float, points: Int, level: float) -> Float:
    """The scale at which pairs just pass the test at ``level``, MC (10): metres, for M_ij and n_ij of shape (k,)."""
    from scipy.stats import norm

    n = np.maximum(points, 1).astype(np.float64)
    return np.asarray(measure_m / (n * HALF_NORMAL_MEAN + float(norm.isf(level)) * np.sqrt(n) * HALF_NORMAL_STD))


def estimate_scales(
    views: ScanViews,
    laid: OdometryMap,
    config: ConsistencyConfig,
    threads: int = 1,
    progress: Progress = no_progress,
) -> Float | None:
    """A scale for each scan, (n,), metres: the largest that one of its pairs along the odometry implies, MC (10).

    A scan without such a pair gets the median. No scale is above ``config.most_scale_m``: a map of raw wheel odometry
    has scales so wide that it would always pass. None if no scan has a pair, since then nothing shows the noise.
    """
    if not np.all(np.isfinite(laid.poses)):
        raise MapmendError("the poses along the odometry edges are not finite; correct the largest measurement")
    pairs = laid.neighbours(config.neighbours, config.neighbours_m)
    placed = views.placed(laid.poses)
    pieces = [pairs[k : k + PAIRS_A_PIECE] for k in range(0, len(pairs), PAIRS_A_PIECE)]
    drop = (config.drop_points, config.drop_share)
    parts = map_in_order(lambda piece: measure(placed, piece, drop), pieces, threads, "scales", progress)
    measured = np.concatenate(parts) if parts else np.zeros((0, 4))
    tested = measured[:, 2] >= config.min_points
    if not tested.any():
        return None
    implied = implied_scale(measured[tested, 3], measured[tested, 2].astype(np.int64), config.scale_level)
    scales = np.full(len(views), -1.0)
    np.maximum.at(scales, pairs[tested, 0], implied)
    np.maximum.at(scales, pairs[tested, 1], implied)
    scales[scales < 0.0] = np.median(scales[scales >= 0.0])
    return np.minimum(scales, config.most_scale_m)


def sensor_scales(n: int, config: ConsistencyConfig) -> Float:
    """The scales by the laser's noise alone, (n,), metres."""
    return np.full(n, np.sqrt(2.0) * config.range_std_m)


def pair_scales(scales: Float, pairs: Int, config: ConsistencyConfig) -> Float:
    """The larger of each pair's two scales, plus the error of optimized poses: (k,), metres."""
    return np.asarray(np.hypot(np.maximum(scales[pairs[:, 0]], scales[pairs[:, 1]]), config.prior_std_m))
