"""The covariance of an odometry edge: that of its matches, the odometry's share, and the part that adds up. IGO (2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2

Float = NDArray[np.float64]


def edge_covariance(
    both_matches: Float, renewed: float, odometry: Float, score: float, min_score: float
) -> tuple[Float, Float]:
    """IGO (2), and its drift: Sigma_obs where the score is good, more and more of Sigma_odo where it is not.

    ``both_matches`` (3, 3): of the two matches that the edge lies between, each with its own noise. The odometry was
    the prior of every match: Sigma_obs is that of both together, and along a corridor, where the beams observe nothing,
    the odometry's. The odometry's part adds up along the trajectory. Of the matches' part adds up what the grid takes
    over: the scans of one node replace a share ``renewed`` of what the grid remembers, and move it by as much of the
    error of one of the two matches.
    """
    told_by_matches = se2.invert_symmetric(both_matches)
    edge = se2.invert_symmetric(told_by_matches + se2.invert_symmetric(odometry))
    drift = edge - (1.0 - 0.5 * renewed) * (edge @ told_by_matches @ edge)
    if score < min_score:
        edge = edge + (min_score - score) / min_score * odometry
        drift = drift + (min_score - score) / min_score * odometry
    return edge, drift
