"""The second pass of a rebuild: loop edges, matched again on the rebuilt grids of their key-nodes. IGO IV-C."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mapmend.geometry import se2
from mapmend.graph.robust import DISTRUST_WEIGHT
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo.guesses import between, is_same, score_noise
from mapmend.igo.observed import Bool, Float
from mapmend.matching.gauss_newton import Match, prior_at
from mapmend.parallel import Progress, no_progress
from mapmend.scan_graph.loop_edges import Agreement, LoopEdge
from mapmend.scan_graph.node_grids import recent_points
from mapmend.scan_graph.scan_graph import ScanGraph


@dataclass(frozen=True)
class LoopResult:
    """``loops``: the remaining loop edges, in their order; ``rows``: which of the old ones each was.

    ``changed`` (k,): which of these have a new measurement. ``matched``: how many were matched again.
    """

    loops: list[LoopEdge]
    rows: list[int]
    changed: Bool
    matched: int


class LoopPass:
    """Lines 15 to 22 of Algorithm 1."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._key_nodes = graph.key_nodes
        self._verify = graph.loop_edges
        self._config = graph.config

    def run(self, wanted: Bool, weights: Float, optimized: Float, progress: Progress = no_progress) -> LoopResult:
        """Matches the ``wanted`` loop edges (k,) again, on grids at the nodes' poses, near the poses ``optimized``.

        ``weights`` (k,): the robust kernel's factor on each. Those that are not wanted stay as they are.
        """
        loops = self._graph.loops
        left: dict[int, tuple[LoopEdge, bool]] = {}
        has_scan = self._graph.scans.are_there()
        # Key-node by key-node, so that each local grid is built once.
        order = sorted(range(len(loops)), key=lambda row: int(self._key_nodes.of_node[loops[row].anchor]))
        for done, row in enumerate(order):
            edge = loops[row]
            if not wanted[row] or not has_scan[edge.node]:
                left[row] = (edge, False)
                continue
            new = self._rematch(edge, float(weights[row]), se2.between(optimized[edge.anchor], optimized[edge.node]))
            if new is not None:
                left[row] = (new, new is not edge)
            if done % 100 == 99:
                progress("rebuilding loops", done + 1, len(loops))
        rows = sorted(left)
        changed = np.array([left[row][1] for row in rows], dtype=np.bool_)
        return LoopResult([left[row][0] for row in rows], rows, changed, int(wanted.sum()))

    def _rematch(self, edge: LoopEdge, weight: float, step: Float) -> LoopEdge | None:
        """The edge itself if it is unchanged, a new one if it moved, None if no match is verified.

        ``step`` (3,): the optimizer's pose of the node relative to the anchor. An edge that the kernel distrusts must
        match at the optimizer's pose, or it is removed: a false loop joins places that look alike, so a match elsewhere
        proves nothing. An edge that nothing contradicts stays.
        """
        graph = self._graph
        k = int(self._key_nodes.of_node[edge.anchor])
        local = self._key_nodes.local_grid(k)
        if local.begin <= edge.node < local.begin + len(local.poses):
            return edge if weight >= DISTRUST_WEIGHT else None  # the grid holds the very scan: nothing to match
        points = graph.points.of(edge.node)
        anchor = local.poses[edge.anchor - local.begin]
        old, guess = se2.compose(anchor, edge.T_anchor_node), se2.compose(anchor, step)
        match = self._best(k, points, old, guess)
        if not self._is_verified(k, points, match):
            # If one scan is not enough, the stretch before it may be: a robot may look at what it had never seen.
            length_m = self._config.key_nodes.trajectory_length_m
            points = recent_points(graph.chains, graph.points, length_m, edge.node)
            match = self._best(k, points, old, guess)
            if not self._is_verified(k, points, match):
                return edge if weight >= DISTRUST_WEIGHT and not self._is_contradicted(k, points, match) else None
        measured = se2.between(anchor, match.pose)
        if weight < DISTRUST_WEIGHT and self._is_far(step, measured):
            return None
        if is_same(edge.T_anchor_node, measured, self._config.igo):
            return edge
        if graph.keeps_information:
            return replace(edge, T_anchor_node=measured)
        return self._verify.edge(edge.anchor, match, points, edge.node)

    def _is_verified(self, k: int, points: Float, match: Match) -> bool:
        """Whether a match on the grid of key-node k has the score, agreement and constraints that the loop search
        requires."""
        agrees = self._verify.agrees(self._agreement(k, points, match))
        return bool(match.score >= self._config.loops.min_score and agrees and self._verify.is_observed(match))

    def _is_contradicted(self, k: int, points: Float, match: Match) -> bool:
        """Whether the grid has seen enough of the points' area, and too many points are contradicted."""
        agreement = self._agreement(k, points, match)
        return self._verify.overlaps(agreement) and not self._verify.agrees(agreement)

    def _agreement(self, k: int, points: Float, match: Match) -> Agreement:
        return self._verify.agreement(self._grid(k), points, match.pose)

    def _grid(self, k: int) -> SurfaceGrid:
        return self._key_nodes.local_grid(k).grid

    def _is_far(self, step: Float, measured: Float) -> bool:
        """Whether a measurement differs from the optimizer's poses by more than their uncertainty."""
        off, loops = se2.between(step, measured), self._config.loops
        return bool(np.hypot(off[0], off[1]) > loops.certain_std_m or abs(off[2]) > loops.certain_std_rad)

    def _best(self, k: int, points: Float, old: Float, guess: Float) -> Match:
        """The best-scoring match from the guesses between two poses (3,); of ties, the pose nearest to ``guess``."""
        grid = self._grid(k)
        covariance = self._verify.certain()
        best = self._graph.matcher.match(grid, points, guess, prior_at(guess, covariance))
        for start in between(old, guess, self._config.loops.guess_every_m):
            other = self._graph.matcher.match(grid, points, start, prior_at(start, covariance))
            if other.score > best.score + score_noise(best.score, len(points)):
                best = other
        return best
