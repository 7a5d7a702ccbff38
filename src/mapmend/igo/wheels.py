"""The wheels of a log: how accurate they are where walls observe the motion, and where they must have slipped.

Along a bare corridor only the odometry shows how far the robot went. Wheels that slip report motion that did not
happen; they never report too little. If a closed loop makes a stretch shorter than reported, by more than these wheels
err elsewhere, they slipped there, and the optimizer's pose is the better guess. A stretch that the loop makes longer is
good, and its edges return to the reported motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmend.config import Config, MotionConfig
from mapmend.geometry import se2
from mapmend.igo.observed import Float, MatchedEdges, runs, turned, without_gaps
from mapmend.scan_graph.chains import Chains, OdometryEdge
from mapmend.scan_graph.motion import STD_PER_MEDIAN, odometry_std

# Shorter steps are not used: they show little of the wheels.
SHORTEST_STEP_M = 0.1
# With fewer steps the wheels' errors are not estimated.
FEWEST_STEPS = 20
# Shorter open stretches are left unchanged.
SHORTEST_STRETCH_M = 1.0
# A motion that changes by less counts as the same.
SAME_M = 0.002
# A stretch that is shorter by this many standard deviations has slipped.
SLIPPED = 3.0


@dataclass(frozen=True)
class Wheels:
    """``scale_off``: the difference of true over reported motion from 1. ``std_after_1_m``: of a random walk about
    it."""

    scale_off: float
    std_after_1_m: float

    def stretch_std_m(self, length_m: float) -> float:
        """The usual error of the reported length of a stretch without slip."""
        return float(np.hypot(self.std_after_1_m * np.sqrt(length_m), self.scale_off * length_m))

    def have_slipped(self, reported_m: float, optimized_m: float) -> bool:
        """Whether a stretch is shorter than reported by more than the usual errors of the wheels."""
        return reported_m - optimized_m > SLIPPED * self.stretch_std_m(reported_m)


def learn_wheels(found_m: Float, reported_m: Float) -> Wheels | None:
    """The wheels' errors from steps that matches observe, ``found_m`` and ``reported_m`` (n,); None for too few.

    They are medians, so that slips among the steps have little influence.
    """
    told = np.abs(reported_m) > SHORTEST_STEP_M
    if told.sum() < FEWEST_STEPS:
        return None
    found, reported = found_m[told], reported_m[told]
    scale = float(np.median(found / reported))
    walk = (found - scale * reported) / np.sqrt(np.abs(reported))
    return Wheels(abs(scale - 1.0), STD_PER_MEDIAN * float(np.median(np.abs(walk))))


def is_slip(reported: Float, found: Float, settings: MotionConfig) -> bool:
    """Whether a motion (3,) falls short of the reported one by more than wheels err over a motion like it.

    The limit is one standard deviation: with a model as wide as the paper's, two would cover nearly every slip.
    """
    way, off = (float(np.hypot(step[0], step[1])) for step in (found, reported - found))
    std, _ = odometry_std(found, settings)
    return way < np.hypot(reported[0], reported[1]) and off > std


class Slips:
    """Finds the open stretches on which the wheels slipped, round after round."""

    def __init__(self, chains: Chains, config: Config) -> None:
        self._chains = chains
        self._config = config
        self._first: dict[int, OdometryEdge] = {}

    def find(
        self, measured: MatchedEdges, reported: Float, optimized: Float, odometry: Float
    ) -> dict[int, OdometryEdge]:
        """Edges of stretches with slip, with the optimizer's length and a wider covariance along it; others stay.

        ``reported`` (n, 3): the odometry's motion of every edge; ``optimized`` (n, 3): the poses; ``odometry``
        (n, 3, 3): Sigma_odo.
        """
        told = ~measured.is_open & (measured.scores >= self._config.match.min_score)
        wheels = learn_wheels(measured.motions[told, 0], reported[told, 0])
        found: dict[int, OdometryEdge] = {}
        if wheels is None:
            return found
        steps = np.concatenate((np.zeros((1, 3)), se2.between(optimized[:-1], optimized[1:])))
        for first, end in runs(without_gaps(measured.is_open)):
            rows = [j for j in range(first, end) if measured.open_axes[j].any()]
            axes = np.array([turned(measured.open_axes[j], self._chains.edges[j, 2]) for j in rows])
            axes[np.einsum("ni,ni->n", axes, reported[rows, :2]) < 0.0] *= -1.0
            length, optimum = (np.einsum("ni,ni->n", axes, motions[rows, :2]) for motions in (reported, steps))
            if length.sum() >= SHORTEST_STRETCH_M and wheels.have_slipped(float(length.sum()), float(optimum.sum())):
                for j, axis, way in zip(rows, axes, optimum, strict=True):
                    found |= self._moved(j, axis, float(way), measured.open_axes[j], odometry[j])
        return found

    def _moved(self, j: int, along: Float, way: float, axis: Float, odometry: Float) -> dict[int, OdometryEdge]:
        """Edge j with another ``way`` along its open axis, (2,) in the frames of its first and of its last node."""
        chains = self._chains
        old = chains.edges[j]
        change = way - float(along @ old[:2])
        if abs(change) < SAME_M:
            return {}
        motion = old.copy()
        motion[:2] += along * change
        first = self._first.setdefault(
            j, OdometryEdge(old.copy(), chains.covariances[j].copy(), chains.drifts[j].copy())
        )
        wide = np.zeros((3, 3))
        wide[:2, :2] = (
            self._config.motion.doubt_spread**2 * float(axis @ odometry[:2, :2] @ axis) * np.outer(axis, axis)
        )
        return {j: OdometryEdge(motion, first.covariance + wide, first.drift + wide)}
