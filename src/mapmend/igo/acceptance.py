"""Whether a match replaces the odometry edge that it differs from. IGO IV-C."""

from __future__ import annotations

import numpy as np

from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo.edge_matching import CONTRADICTS, PossiblePoses
from mapmend.igo.fits import TIE, Fits
from mapmend.igo.guesses import is_same
from mapmend.igo.observed import Float, turned
from mapmend.igo.wheels import is_slip
from mapmend.matching.gauss_newton import Match
from mapmend.scan_graph.scan_graph import ScanGraph

# An edge is biased if its re-match leaves it by more than this, in squared standard deviations times what is usual: the
# 99.9 % quantile of chi-square with three degrees of freedom; its median; and over how many edges the usual is taken.
FAR_CHI2, MEDIAN_CHI2, SCATTER_OVER = 16.27, 2.37, 100


class Acceptance:
    """Compares re-matches with the edges, and learns how far these usually differ."""

    def __init__(self, graph: ScanGraph, fits: Fits) -> None:
        self._chains = graph.chains
        self._config = graph.config
        self._fits = fits
        self._scatter = np.zeros(len(graph))

    def differs(self, j: int, found: Float) -> bool:
        """Whether a re-match differs from edge j; stores the difference in squared standard deviations of the edge."""
        off = se2.between(self._chains.edges[j], found)
        self._scatter[j] = float(off @ np.linalg.solve(self._chains.covariances[j], off))
        return not is_same(self._chains.edges[j], found, self._config.igo)

    def is_accepted(self, j: int, grid: SurfaceGrid, points: Float, match: Match, poses: PossiblePoses) -> bool:
        """Whether a match replaces edge j: by fit, and where fits tie by the optimizer.

        A difference within the scatter of this log's edges does not count, unless the gain in fit is large. Where
        wheels slipped, a poor score is enough: the old edge is not better, and the covariance reflects the poor score.
        """
        old, guess = poses.old, poses.guess
        is_good = match.score >= self._config.match.min_score
        if not is_good and not is_slip(poses.motion, se2.between(poses.behind, match.pose), self._config.motion):
            return False
        gain, noise = self._fits.gain(grid, points, match.pose, old)
        gain -= self._doubt(match.pose, poses)
        if gain > max(TIE * noise, self._config.igo.clear_gain):
            return True
        if not is_good or not self._is_beyond_scatter(j):
            return False
        nearer = np.hypot(*(match.pose - guess)[:2]) < 0.5 * np.hypot(*(old - guess)[:2])
        return bool(gain >= -TIE * noise and nearer)

    def _is_beyond_scatter(self, j: int) -> bool:
        """Whether the re-match of edge j differs more than usual in this log, near here.

        Among leaves, matches of one scan on two grids differ by more than their covariances. The reference is the
        usual squared Mahalanobis distance of the last edges.
        """
        before = self._scatter[max(1, j - SCATTER_OVER) : j + 1]
        usual = max(float(np.median(before)) / MEDIAN_CHI2, 1.0)
        return bool(self._scatter[j] > FAR_CHI2 * usual)

    def _doubt(self, pose: Float, poses: PossiblePoses) -> float:
        """The additional gain in fit that a pose needs if it is farther from the odometry than the edge's.

        It is zero if the pose is nearer to the optimizer's, or if slip explains it: if it falls short of the reported
        motion by more than the wheels usually err. Wheels never report too little.
        """
        predicted, old, guess, std = poses.predicted, poses.old, poses.guess, poses.std
        if np.hypot(*(pose - guess)[:2]) < np.hypot(*(old - guess)[:2]):
            return 0.0
        off, off_before = se2.between(predicted, pose), se2.between(predicted, old)
        falls_short = turned(poses.motion[:2], -poses.motion[2]) @ off[:2] < 0.0
        if falls_short and np.hypot(off[0], off[1]) > CONTRADICTS * std[0]:
            return 0.0
        new, before = (
            min(((o[0] ** 2 + o[1] ** 2) / std[0] ** 2 + (o[2] / std[1]) ** 2) / 9.0, 1.0) for o in (off, off_before)
        )
        return self._config.motion.prior_weight * max(new - before, 0.0)
