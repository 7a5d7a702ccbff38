"""A few Gauss-Newton steps of a scan on the surfaces of a grid: the matcher when the pose is not in doubt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching import _kernels
from mapmend.matching.uncertainty import Uncertainty, match_uncertainty

Float = NDArray[np.float64]

NO_PRIOR = np.zeros((4, 3))


@dataclass(frozen=True)
class Match:
    """The result of a match: ``pose`` (3,), the share of the points that found a counterpart, and the normal matrix.

    ``normal_matrix`` (3, 3): of the squared distances along the surfaces' normals, in the axes of the grid.
    ``converged``: whether the last step was short enough to stop.
    """

    pose: Float
    score: float
    matched: int
    normal_matrix: Float
    converged: bool = True


class SurfaceMatcher:
    """Matches scans on grids with one set of settings."""

    def __init__(self, config: MatchConfig) -> None:
        self.config = config
        self._settings = match_settings(config)

    def match(self, grid: SurfaceGrid, points: Float, start: Float, prior: Float = NO_PRIOR) -> Match:
        """Matches ``points`` (n, 5) from ``start`` (3,); ``prior`` (4, 3): information in map axes, expected pose."""
        found = _kernels.match_points(grid.tiles, points, start, prior, self._settings)
        return Match(
            pose=found.pose,
            score=found.matched / len(points) if len(points) else 0.0,
            matched=found.matched,
            normal_matrix=found.normal_matrix,
            converged=bool(found.converged),
        )

    def uncertainty(self, grid: SurfaceGrid, points: Float, match: Match) -> Uncertainty:
        """How certain the ``match`` of ``points`` (n, 5) on ``grid`` is."""
        return match_uncertainty(grid, points, match.pose, self.config)

    def judge(self, grid: SurfaceGrid, points: Float, pose: Float) -> tuple[int, int, int]:
        """How many of ``points`` (n, 5) at ``pose`` the grid confirms, contradicts, and has not seen."""
        reach_m = self._settings.reach_m
        found = _kernels.score_points(grid.tiles, points, pose, 0.5 * reach_m, reach_m)
        return found.matched, found.contradicted, found.unseen


def match_settings(config: MatchConfig, is_roughness_used: bool = True) -> _kernels.MatchSettings:
    """The settings of the kernel. All lengths are floats: for whole numbers Numba would compile the kernel again."""
    return _kernels.MatchSettings(
        float(config.reach_m),
        float(config.half_weight_m),
        float(config.distance_std_m),
        config.iterations,
        float(config.convergence_m),
        float(config.widening),
        is_roughness_used,
    )


def round_prior(pose: Float, translation_std_m: float, rotation_std_rad: float) -> Float:
    """The ``prior`` argument for a position equally uncertain in every direction: cheap enough for every scan."""
    prior = np.zeros((4, 3))
    prior[0, 0] = prior[1, 1] = 1.0 / translation_std_m**2
    prior[2, 2] = 1.0 / rotation_std_rad**2
    prior[3] = pose
    return prior


def prior_at(pose: Float, covariance: Float) -> Float:
    """The ``prior`` argument of `SurfaceMatcher.match`: ``covariance`` (3, 3) in the frame of ``pose`` (3,)."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    prior = np.empty((4, 3))
    prior[:3] = turn @ se2.invert_symmetric(covariance) @ turn.T
    prior[3] = pose
    return prior
