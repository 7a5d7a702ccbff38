"""The first pass of a rebuild: edges between successive nodes, matched again behind the rebuilt trail. IGO IV-C.

`edge_matching` matches an edge, `acceptance` says whether the match replaces it, `renewal` makes the new edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo.acceptance import Acceptance
from mapmend.igo.edge_matching import EdgeMatcher, PossiblePoses
from mapmend.igo.fits import Fits
from mapmend.igo.observed import Bool, Float, MatchedEdges
from mapmend.igo.renewal import Renewal
from mapmend.igo.steady_stretches import SteadyStretches
from mapmend.igo.trail import TrailGrid
from mapmend.parallel import Progress, no_progress
from mapmend.scan_graph.chains import OdometryEdge
from mapmend.scan_graph.motion import odometry_std
from mapmend.scan_graph.scan_graph import ScanGraph


@dataclass(frozen=True)
class OdometryResult:
    """``edges``: the new ones, by the node that they end at. ``poses`` (n, 3): of the rebuilt map. ``matched``: how
    many edges were matched, of which ``changed`` differ from before, accepted or not. ``unsettled`` (n,): which edges
    are to be matched again."""

    edges: dict[int, OdometryEdge]
    poses: Float
    matched: int
    changed: int
    unsettled: Bool


class OdometryPass:
    """Lines 4 to 14 of Algorithm 1."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._matched = MatchedEdges.of_nothing(len(graph))
        self._reported = graph.hung.reported_motions()
        fits = Fits(graph.config)
        self._matcher = EdgeMatcher(graph, fits)
        self._acceptance = Acceptance(graph, fits)
        self._steady = SteadyStretches(graph, self._matched)
        self._renewal = Renewal(graph, self._matched, self._steady)

    def can_match(self) -> Bool:
        """Which edges (n,) can be matched, each identified by its last node: that node must carry a scan."""
        return self._graph.chains.has_edge() & self._graph.scans.are_there()

    def run(self, wanted: Bool, progress: Progress = no_progress) -> OdometryResult:
        """Matches the ``wanted`` edges (n,) again, each identified by its last node."""
        chains, n = self._graph.chains, len(self._graph)
        trail, optimized = TrailGrid(self._graph), chains.poses.copy()
        poses = optimized.copy()
        accepted, differs = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        ends = np.flatnonzero(self._graph.chains.has_edge()).tolist()
        for j in ends:
            step = se2.between(optimized[j - 1], optimized[j])
            if wanted[j]:
                step, differs[j], accepted[j] = self._rematch(j, poses[j - 1], step, trail.before(j, poses))
            poses[j] = se2.compose(poses[j - 1], step)
            if j % 100 == 99 or j == n - 1:
                progress("rebuilding", j + 1, n)
        edges = self._renewal.new_edges(wanted, accepted, optimized, self._reported)
        for j in ends:
            step = edges[j].motion if j in edges else se2.between(optimized[j - 1], optimized[j])
            poses[j] = se2.compose(poses[j - 1], step)
        replaced = np.isin(np.arange(n), list(edges))
        # The errors of neighbouring edges cancel: an edge beside a replaced one that differed is matched once more.
        beside = np.zeros(n, dtype=np.bool_)
        beside[1:] |= replaced[:-1]
        beside[:-1] |= replaced[1:]
        changed = max(int(differs.sum()), len(edges))
        return OdometryResult(edges, poses, int(wanted.sum()), changed, replaced | (differs & beside))

    def _rematch(self, j: int, behind: Float, step: Float, grid: SurfaceGrid) -> tuple[Float, bool, bool]:
        """Matches node j on the grid of those before it: the step to take, whether it differs, and is accepted."""
        graph, matched = self._graph, self._matched
        points = graph.points.of(j)
        motion = self._reported[j] if graph.config.motion.use_odometry else self._steady.expected(j, step)
        predicted, old, guess = (se2.compose(behind, one) for one in (motion, graph.chains.edges[j], step))
        poses = PossiblePoses(behind, motion, odometry_std(motion, graph.config.motion), predicted, old, guess)
        match = self._matcher.best(grid, points, poses)
        uncertainty = graph.matcher.uncertainty(grid, points, match)
        found, information, axis = self._matcher.observed(grid, points, match, uncertainty.point_variance, poses)
        matched.motions[j], matched.information[j], matched.open_axes[j] = found, information, axis
        matched.covariances[j], matched.renewed[j] = uncertainty.covariance, uncertainty.renewed
        matched.scores[j] = match.score
        if not graph.config.motion.use_odometry and self._steady.may_be_biased(j):
            return self._steady.step(j), True, False
        differs = self._acceptance.differs(j, found)
        accepted = differs and not axis.any() and self._acceptance.is_accepted(j, grid, points, match, poses)
        return (found if accepted else step), differs, accepted
