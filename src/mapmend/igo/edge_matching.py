"""How a node is matched again on its trail: from which guesses, and which axes the match leaves open. IGO IV-C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo.fits import TIE, Fits
from mapmend.igo.guesses import between, is_between
from mapmend.igo.observed import Float, Observer, turned
from mapmend.matching.gauss_newton import Match, round_prior
from mapmend.scan_graph.scan_graph import ScanGraph

# A match is doubtful if it fits less well than usual, or is this many standard deviations off the odometry.
CONTRADICTS = 2.0
# A node's share of the usual fit makes it follow some twenty nodes.
USUAL_SHARE = 0.05


@dataclass(frozen=True)
class PossiblePoses:
    """Possible poses (3,) of a node: the previous node's, ``behind``, and its own by odometry, edge and optimizer.

    ``motion`` (3,): the expected motion of the edge, with its ``std``: translation [m] and rotation [rad].
    """

    behind: Float
    motion: Float
    std: tuple[float, float]
    predicted: Float
    old: Float
    guess: Float


class EdgeMatcher:
    """Matches nodes again, and learns the usual fit."""

    def __init__(self, graph: ScanGraph, fits: Fits) -> None:
        self._matcher = graph.matcher
        self._guess_every_m = graph.config.loops.guess_every_m
        self._clear_gain = graph.config.igo.clear_gain
        self._by_laser_alone = not graph.config.motion.use_odometry
        self._observer = Observer(graph.config)
        self._fits = fits
        self._usual_fit = 1.0

    def best(self, grid: SurfaceGrid, points: Float, poses: PossiblePoses) -> Match:
        """The best-fitting match from guesses between poses; of fits that tie, the pose nearest to the optimizer's.

        Guesses lie every few centimetres between the pose by the edge and the optimizer's. If the first match fits less
        well than usual or contradicts the odometry, wheels may have slipped, so that a part of the motion did not
        happen. Then guesses lie also between no motion and the reported motion.
        """
        behind, predicted, guess, std = poses.behind, poses.predicted, poses.guess, poses.std
        best = self._matcher.match(grid, points, guess, round_prior(predicted, *std))
        off = se2.between(predicted, best.pose)
        fit = self._fits.fit(grid, points, best.pose)
        doubtful = fit < self._usual_fit or np.hypot(off[0], off[1]) > CONTRADICTS * std[0]
        others = between(poses.old, guess, self._guess_every_m)
        if doubtful and not self._by_laser_alone:
            others += [predicted, behind, *between(behind, predicted, self._guess_every_m)]
        for start in others:
            other = self._matcher.match(grid, points, start, round_prior(start if doubtful else predicted, *std))
            is_possible = not doubtful or is_between(behind, predicted, other.pose, 3.0 * std[0])
            gain, noise = self._fits.gain(grid, points, other.pose, best.pose) if is_possible else (0.0, 1.0)
            if gain > noise:
                best, fit = other, self._fits.fit(grid, points, other.pose)
        self._usual_fit += USUAL_SHARE * (fit - self._usual_fit)
        return best

    def observed(
        self, grid: SurfaceGrid, points: Float, match: Match, point_variance: float, poses: PossiblePoses
    ) -> tuple[Float, Float, Float]:
        """The motion (3,) that a match measures, its information (3, 3), and the axis (2,) that it leaves open.

        Along an open axis the motion is the odometry's. If the scan then fits worse, the axis was not open and the
        match is kept; the axis returned is then zero.
        """
        information, axis = self._observer.information(grid, points, match, point_variance)
        found = se2.between(poses.behind, match.pose)
        if not axis.any():
            return found, information, axis
        along, held = turned(axis, found[2]), found.copy()
        held[:2] += along * float(along @ (poses.motion[:2] - found[:2]))
        gain, noise = self._fits.gain(grid, points, match.pose, se2.compose(poses.behind, held))
        if gain > max(TIE * noise, self._clear_gain):
            return found, information, np.zeros(2)
        return held, information, axis
