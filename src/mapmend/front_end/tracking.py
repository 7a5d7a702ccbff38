"""The pose of each scan: predicted by odometry, matched on the global grid, searched for if in doubt. IGO III-A."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.gauss_newton import Match, SurfaceMatcher, round_prior
from mapmend.matching.hypotheses import Expected, UsualScore, find_among
from mapmend.scan_graph.motion import STD_PER_MEDIAN, draw_hypotheses, odometry_covariance, odometry_std

Float = NDArray[np.float64]

# The adaptation of the median difference between odometry and good matches: a factor of e in a hundred scans.
MEDIAN_SHARE = 0.01


@dataclass(frozen=True)
class Tracked:
    """One scan's match and whether hypotheses were needed for it."""

    match: Match
    searched: bool


class Tracker:
    """Follows the robot from scan to scan on a grid."""

    def __init__(self, matcher: SurfaceMatcher, config: Config) -> None:
        self._matcher = matcher
        self._config = config
        self._usual_score = UsualScore(config.match)
        # The usual correction of the odometry by good matches, in the model's standard deviations: translation,
        # rotation.
        self._usual_step = np.full(2, 1.0 / STD_PER_MEDIAN)
        self._random = np.random.default_rng(config.seed)

    def track(self, grid: SurfaceGrid, points: Float, before: Float, motion: Float) -> Tracked:
        """Finds the pose of a scan, ``points`` (n, 5), which is at ``before * motion`` by odometry; poses of shape
        (3,)."""
        predicted = se2.compose(before, motion)
        prior = round_prior(predicted, *odometry_std(motion, self._config.motion))
        match = self._matcher.match(grid, points, predicted, prior)
        searched = self._usual_score.is_doubtful(match.score, len(points))
        if searched:
            hypotheses = self._hypotheses(before, predicted, odometry_covariance(motion, self._config.motion))
            best = self._best_of(grid, points, hypotheses, prior, match)
            # If the result of the search is doubtful too, it is not used.
            match = match if self._usual_score.is_doubtful(best.score, len(points)) else best
        self._usual_score.learn(match.score)
        self._learn(match, prior)
        return Tracked(self._tempered(match, predicted), searched)

    def _learn(self, match: Match, prior: Float) -> None:
        """Tracks the error of the odometry at good matches: its median, on which slips have little influence."""
        if match.score < self._config.match.min_score:
            return
        x, y, turn = (match.pose - prior[3]).tolist()
        turn = math.remainder(turn, math.tau)
        off = (math.hypot(x, y) * math.sqrt(prior[0, 0]), abs(turn) * math.sqrt(prior[2, 2]))
        for axis in range(2):
            self._usual_step[axis] *= math.exp(MEDIAN_SHARE if off[axis] > self._usual_step[axis] else -MEDIAN_SHARE)

    def _tempered(self, match: Match, predicted: Float) -> Match:
        """A poor match, drawn towards the odometry with the weights of IGO (2).

        The variance of the match is mostly the share of Sigma_odo that (2) adds. That of the odometry is the one
        observed so far in this log, at most that of the model. Among leaves, this keeps the heading from drifting.
        """
        least = self._config.match.min_score
        poor = max(least - match.score, 0.0) / least
        if poor == 0.0:
            return match
        known = np.minimum(STD_PER_MEDIAN * self._usual_step, 1.0) ** 2
        share = poor / (poor + known)
        step = predicted - match.pose
        pose = match.pose + share[[0, 0, 1]] * np.array([step[0], step[1], math.remainder(step[2], math.tau)])
        return replace(match, pose=pose)

    def _hypotheses(self, before: Float, predicted: Float, covariance: Float) -> Float:
        """Draws from the odometry model, spread wider: if a match is doubtful, the model may be wrong, for wheels slip.

        The prediction itself and a robot that did not move are among them.
        """
        motion = self._config.motion
        drawn = draw_hypotheses(predicted, motion.doubt_spread**2 * covariance, motion.hypotheses, self._random)
        return np.concatenate((predicted[None], before[None], drawn))

    def _best_of(self, grid: SurfaceGrid, points: Float, hypotheses: Float, prior: Float, first: Match) -> Match:
        """The correlative search over all hypotheses, refined; returns ``first`` unless another match is better."""
        config = self._config
        three_sigma_m, three_sigma_rad = 3.0 / math.sqrt(prior[0, 0]), 3.0 / math.sqrt(prior[2, 2])
        expected = Expected(prior[3], three_sigma_m, three_sigma_rad, config.motion.prior_weight)
        found = find_among(grid.tiles, points, hypotheses, expected, config.match)
        if found is None:
            return first
        refined = self._matcher.match(grid, points, found, prior)
        is_better = expected.prefers((refined.pose, refined.score), (first.pose, first.score), len(points))
        return refined if is_better else first
