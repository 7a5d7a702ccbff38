"""Steady motion: the motion that neither walls nor wheels observe, from the speed before and after.

Without odometry, the front end predicts each step by the step before: along a bare corridor the errors of one step
enter the next, and the speed wanders. In the whole log, both ends of such a stretch are known. Here the speed of every
edge is estimated from the matches of all edges and from the usual change of the speed: most of the time a robot keeps
its speed, and sometimes it changes it at once (a heavy-tailed process, by iterated weights).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from mapmend.scan_graph.motion import STD_PER_MEDIAN

Float = NDArray[np.float64]

# The least change of speed of any robot: metres and radians per second, after one second.
LEAST_CHANGE = np.array([0.005, 0.005, 0.005])
ITERATIONS = 6
# Changes beyond this many standard deviations count as decisions of the robot, by the weights of a Cauchy cost.
CAUCHY_SCALE = 2.4
# An edge is used for the speed if its own standard deviation, in units of speed, is below this.
KNOWN_SPEED = 0.05


@dataclass(frozen=True)
class SteadyMotion:
    """``motions`` (n, 3) of the edges, each in the frame of its first node, and the factor from which covariances
    follow."""

    motions: Float
    seconds: Float
    factor: Float

    def covariance_of_sum(self, first: int, end: int) -> Float:
        """The covariance (3, 3) of the total motion from edge ``first`` to ``end`` - 1, without the effect of
        headings."""
        pick = np.zeros((3 * len(self.seconds), 3))
        for axis in range(3):
            pick[3 * first + axis : 3 * end + axis : 3, axis] = self.seconds[first:end]
        return np.asarray(pick.T @ cho_solve_banded((self.factor, True), pick))


def usual_change(motions: Float, information: Float, seconds: Float) -> Float:
    """How much the speed changes in a second, standard deviations (3,): the median over edges that matches observe."""
    speed = motions / seconds[:, None]
    variance = np.linalg.inv(information + 1e-6 * np.eye(3))[:, np.arange(3), np.arange(3)] / seconds[:, None] ** 2
    known = np.all(variance < KNOWN_SPEED**2, axis=1)
    pairs = known[1:] & known[:-1]
    if pairs.sum() < 10:
        return LEAST_CHANGE
    change = np.abs(np.diff(speed, axis=0))[pairs]
    spread = (STD_PER_MEDIAN * np.median(change, axis=0)) ** 2
    own = np.median(variance[1:][pairs] + variance[:-1][pairs], axis=0)
    between_s = float(np.median(0.5 * (seconds[1:] + seconds[:-1])[pairs]))
    return np.asarray(np.sqrt(np.maximum((spread - own) / between_s, LEAST_CHANGE**2)))


def steady_motion(motions: Float, information: Float, seconds: Float, change: Float) -> SteadyMotion:
    """The motions of n edges, from their matches and from a speed that changes little.

    ``motions`` (n, 3) and ``information`` (n, 3, 3): those of the matches alone; zero along axes that they leave open.
    ``seconds`` (n,): how long each edge took, above 0. ``change`` (3,): `usual_change`.
    """
    n = len(motions)
    own = information * seconds[:, None, None] ** 2 + 1e-9 * np.eye(3)
    right = np.einsum("nij,nj->ni", information, motions) * seconds[:, None]
    step_s = 0.5 * (seconds[1:] + seconds[:-1])
    stiff = 1.0 / (change**2 * step_s[:, None])
    weights = np.ones_like(stiff)
    for _ in range(ITERATIONS):
        factor = cholesky_banded(_banded(own, stiff * weights), lower=True, check_finite=False)
        speed = cho_solve_banded((factor, True), right.ravel(), check_finite=False).reshape(n, 3)
        weights = 1.0 / (1.0 + np.diff(speed, axis=0) ** 2 * stiff / CAUCHY_SCALE**2)
    return SteadyMotion(speed * seconds[:, None], seconds, factor)


def _banded(own: Float, ties: Float) -> Float:
    """The normal matrix in LAPACK's lower band form, shape (4, 3 n): own blocks (n, 3, 3), ties (n - 1, 3)."""
    n = len(own)
    band = np.zeros((4, n, 3))
    diagonal = own[:, np.arange(3), np.arange(3)].copy()
    diagonal[1:] += ties
    diagonal[:-1] += ties
    band[0] = diagonal
    band[1, :, 0], band[1, :, 1] = own[:, 1, 0], own[:, 2, 1]
    band[2, :, 0] = own[:, 2, 0]
    band[3, :-1] = -ties
    return band.reshape(4, 3 * n)
