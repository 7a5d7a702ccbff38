"""The edges that replace others, with their covariances by IGO (2)."""

from __future__ import annotations

import numpy as np

from mapmend.geometry import se2
from mapmend.igo.guesses import is_same
from mapmend.igo.observed import Bool, Float, Int, MatchedEdges
from mapmend.igo.steady_stretches import SteadyStretches
from mapmend.igo.wheels import Slips, is_slip
from mapmend.matching.uncertainty import UNSEEN_STD_M
from mapmend.scan_graph.chains import OdometryEdge
from mapmend.scan_graph.edge_covariance import edge_covariance
from mapmend.scan_graph.motion import odometry_covariance
from mapmend.scan_graph.scan_graph import ScanGraph

# An edge over a slip gets its new covariance if that is below this share of the old one, by determinants.
SURER = 0.5


class Renewal:
    """Makes new edges from the matches of a pass, ``matched``."""

    def __init__(self, graph: ScanGraph, matched: MatchedEdges, steady: SteadyStretches) -> None:
        self._graph = graph
        self._chains = graph.chains
        self._config = graph.config
        self._matched = matched
        self._steady = steady
        self._slips = Slips(graph.chains, graph.config)

    def new_edges(self, wanted: Bool, accepted: Bool, optimized: Float, reported: Float) -> dict[int, OdometryEdge]:
        """The edges to replace, by the node that each ends at.

        ``wanted``, ``accepted`` (n,): which were matched, and which of these replace the old ones. ``optimized`` (n,
        3): the poses before the pass. ``reported`` (n, 3): the odometry's motions.
        """
        by_laser_alone = not self._config.motion.use_odometry
        expected = self._matched.motions if by_laser_alone else reported
        happened = expected.copy() if by_laser_alone else self._happened(expected)
        odometry = np.array([odometry_covariance(step, self._config.motion) for step in happened])
        slipped: dict[int, OdometryEdge] = {}
        if by_laser_alone:
            accepted = accepted | self._steady.level_speeds(wanted, odometry)
        else:
            slipped = self._slips.find(self._matched, expected, optimized, odometry)
        renewed = {int(j): self._new_edge(int(j), odometry[j]) for j in np.flatnonzero(accepted)}
        rows = np.flatnonzero(wanted & ~accepted & (happened != expected).any(axis=1))
        return {**{j: new for j, new in slipped.items() if wanted[j]}, **self._surer(rows, odometry), **renewed}

    def _happened(self, expected: Float) -> Float:
        """The motions (n, 3) for Sigma_odo: the reported ones, but the matched ones where wheels slipped.

        For the model, a spin of two metres is as uncertain as a drive of two metres. If the robot moved less, by more
        than the wheels err over the real motion, this uncertainty is wrong for the edge.
        """
        happened = expected.copy()
        for j in np.flatnonzero(self._matched.scores > 0.0):
            if is_slip(expected[j], self._matched.motions[j], self._config.motion):
                happened[j] = self._matched.motions[j]
        return happened

    def _surer(self, rows: Int, odometry: Float) -> dict[int, OdometryEdge]:
        """Edges over slips that are unchanged, but whose new covariance is smaller than the one with the slip."""
        chains, surer = self._chains, {}
        for j in (int(row) for row in rows):
            new = self._new_edge(j, odometry[j])
            is_surer = np.linalg.det(new.covariance) < SURER * np.linalg.det(chains.covariances[j])
            if is_surer and is_same(chains.edges[j], new.motion, self._config.igo):
                surer[j] = OdometryEdge(chains.edges[j].copy(), new.covariance, new.drift)
        return surer

    def _new_edge(self, j: int, odometry: Float) -> OdometryEdge:
        matched = self._matched
        motion = matched.motions[j]
        carry = se2.adjoint(se2.inverse(motion))
        before = matched.covariances[j - 1] if matched.scores[j - 1] else matched.covariances[j]
        both = matched.covariances[j] + carry @ before @ carry.T
        if matched.is_open[j]:
            both = opened(both, matched.open_axes[j])
        if self._graph.keeps_information:
            return OdometryEdge(motion, self._chains.covariances[j].copy(), self._chains.drifts[j].copy())
        return OdometryEdge(
            motion,
            *edge_covariance(both, matched.renewed[j], odometry, matched.scores[j], self._config.match.min_score),
        )


def opened(covariance: Float, axis: Float) -> Float:
    """A covariance (3, 3) that leaves an axis (2,) open."""
    wide = covariance.copy()
    wide[:2, :2] += UNSEEN_STD_M**2 * np.outer(axis, axis)
    return wide
