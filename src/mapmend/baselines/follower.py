"""The robot's motion between two updates of the filter: each scan is matched on the best particle's map.

A filter that only adds up the odometry between updates starts its match at a wrong pose when wheels slip or the
odometry jumps. Here the scans decide which of the reported steps happened. The proposal is given only those.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.baselines._filter_kernels import Likelihood, log_likelihood
from mapmend.config import Config, GMappingConfig
from mapmend.geometry import se2
from mapmend.grid.likelihood import Tiles
from mapmend.matching._kernels import match_points
from mapmend.matching.gauss_newton import match_settings, round_prior
from mapmend.matching.hypotheses import Expected, UsualScore, find_among
from mapmend.matching.plausible_steps import plausible_steps
from mapmend.scan import ScanLog

Float = NDArray[np.float64]

# No motion is known better than this, however little the wheels report.
LEAST_STD_M = 0.01
LEAST_STD_RAD = 0.005


@dataclass(frozen=True)
class Step:
    """The robot's step from the scan before to this scan.

    ``tracked`` (3,): as measured by matching the scan. ``believed`` (3,): what the proposal uses as the motion. It is
    the odometry's step, unless that step is impossible or the scan refutes it: then it is the tracked step. In that
    case ``unknown`` (2,) is its variance in translation (m^2) and rotation (rad^2), otherwise zero.
    """

    tracked: Float
    believed: Float
    unknown: Float


@dataclass(frozen=True)
class _Place:
    """A match from ``start`` (3,): its ``pose`` (3,) and the share of the points that found their surface."""

    start: Float
    pose: Float
    score: float


class Follower:
    """Follows the robot through a log, scan by scan."""

    def __init__(self, log: ScanLog, config: Config, random: np.random.Generator) -> None:
        self._config = config
        self._random = random
        self._motions = se2.between(log.odometry[:-1], log.odometry[1:])
        self._steps = plausible_steps(self._motions, log.stamps_s)
        self._usual_score = UsualScore(config.match)
        self._match_settings = match_settings(config.match, is_roughness_used=False)
        self._last_step = np.zeros(3)
        self.searched = 0
        self.refuted = 0

    def follow(self, k: int, particle_map: Tiles, points: Float, before: Float) -> Step:
        """The step to scan k, on the best particle's map; at the scan before, the robot was at ``before`` (3,)."""
        config, row = self._config, k - 1
        motion = self._motions[row] if config.motion.use_odometry else self._last_step
        plausibility, fast = float(self._steps.plausibility[row]), self._steps.fast
        refuted = plausibility == 0.0
        # If the odometry jumped, the best guess is that the robot moves on as in its last step.
        guess = self._last_step if refuted else motion
        std = fast if refuted else np.array(motion_std(*size_of(motion), config.gmapping))
        guessed = se2.compose(before, guess)
        place = self._match(particle_map, points, guessed, std)
        if len(points) > 0 and (plausibility < 1.0 or self._is_doubtful(place, points)):
            self.searched += 1
            weight = config.motion.prior_weight * (1.0 if refuted else plausibility)
            expected = Expected(guessed, 3.0 * std[0], 3.0 * std[1], weight)
            best, explained = place, self._explained(particle_map, points, place.pose)
            share = explained
            for start in self._starts(particle_map, points, before, motion):
                other = self._match(particle_map, points, start, std)
                other_share = self._explained(particle_map, points, other.pose)
                if expected.prefers((other.pose, other_share), (best.pose, share), len(points)):
                    best, share = other, other_share
            # If the result is doubtful too, it is used only if the step is odd, or if it gains more than by chance.
            is_clear = plausibility < 1.0 or share > explained + config.gmapping.minimum_score
            if is_clear or not self._is_doubtful(best, points):
                place = best
                refuted |= _is_beyond(se2.between(se2.compose(before, motion), place.pose), fast)
        self._usual_score.learn(place.score)
        tracked = se2.between(before, place.pose if place.score >= config.gmapping.minimum_score else place.start)
        self._last_step = tracked
        if not refuted:
            return Step(tracked, motion, np.zeros(2))
        self.refuted += 1
        return Step(tracked, tracked, fast**2)

    def _is_doubtful(self, place: _Place, points: Float) -> bool:
        return self._usual_score.is_doubtful(place.score, len(points))

    def _starts(self, particle_map: Tiles, points: Float, before: Float, motion: Float) -> list[Float]:
        """Poses of the robot to try if a match is doubtful: the odometry's, and the results of two searches.

        The first search is around the odometry's step, within the model's spread. The second is around a robot that
        stood still and around one that repeats its last step, within the size of a fast step.
        """
        settings, fast = self._config.motion, self._steps.fast
        spread = settings.doubt_spread * np.array(motion_std(*size_of(motion), self._config.gmapping))
        starts = [se2.compose(before, motion)]
        for about, std, also in ((motion, spread, motion), (self._last_step, fast, np.zeros(3))):
            draws = self._random.standard_normal((settings.hypotheses, 3)) * std[[0, 0, 1]]
            steps = np.concatenate(([about, also], se2.compose(about, draws)))
            expected = Expected(se2.compose(before, about), std[0], std[1], settings.prior_weight)
            found = find_among(particle_map, points, se2.compose(before, steps), expected, self._config.match)
            if found is not None:
                starts.append(found)
        return starts

    def _match(self, particle_map: Tiles, points: Float, start: Float, std: Float) -> _Place:
        """Gauss-Newton from ``start``, with a prior there of standard deviations ``std`` (2,), metres and radians."""
        found = match_points(particle_map, points, start, round_prior(start, *std), self._match_settings)
        return _Place(start, found.pose, found.matched / max(len(points), 1))

    def _explained(self, particle_map: Tiles, points: Float, pose: Float) -> float:
        """The share of a scan, 0 to 1, that the map explains at a pose by the filter's own observation model.

        A beam that ends in space never seen counts half, so that a robot that enters a new room does not lose its pose
        to a wrong one within the known map.
        """
        worst_m = float(self._config.match.reach_m)
        cost = -2.0 * log_likelihood(particle_map, points, pose, Likelihood(1.0, worst_m))
        return 1.0 - float(cost) / (worst_m**2 * len(points))


def size_of(motion: Float) -> tuple[float, float]:
    """The way (m) and the turn (rad) of a motion."""
    return math.hypot(motion[0], motion[1]), abs(float(motion[2]))


def motion_std(way_m: float, turn_rad: float, settings: GMappingConfig) -> tuple[float, float]:
    """Standard deviations of the odometry over a way and a turn: of the translation (m), of the rotation (rad)."""
    translation = math.hypot(settings.srr * way_m, settings.srt * turn_rad)
    rotation = math.hypot(settings.str * way_m, settings.stt * turn_rad)
    return max(translation, LEAST_STD_M), max(rotation, LEAST_STD_RAD)


def _is_beyond(difference: Float, most: Float) -> bool:
    """Whether a motion (3,) is more than ``most`` (2,), metres and radians."""
    way_m, turn_rad = size_of(difference)
    return bool(way_m > most[0] or turn_rad > most[1])
