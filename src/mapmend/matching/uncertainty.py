"""How certain a match is: the noise of its own beams, and the errors of the surfaces, which many beams share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.surface import MEAN_MEMORY, SurfaceGrid
from mapmend.matching import _uncertainty_kernels as kernels

Float = NDArray[np.float64]

_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])

# Many logs hold ranges in whole centimetres: the rounding alone has a standard deviation of 2.9 mm, which neighbouring
# beams that are rounded alike do not show.
LEAST_NOISE_M = 0.003
# The error of a surface that the beams of one scan do not show: a hundredth of a cell.
LEAST_SURFACE_M = 0.0005
UNSEEN_STD_M = 10.0
# The noise is taken from at least so many deviations, and from none beyond so many standard deviations: those are
# corners and clutter.
FEWEST_DEVIATIONS, MOST_DEVIATION = 8, 3.0
# The variance of a point's deviation from the middle of its neighbours, over that of a point.
DEVIATION_VARIANCE = 1.5
# The numbers that a match chooses, and which the distances to the surfaces therefore lack.
CHOSEN = 3


@dataclass(frozen=True)
class Uncertainty:
    """What the pose of a match may be off by, in the pose's own frame.

    ``own`` (3, 3): by the noise of the scan's beams. ``surfaces`` (3, 3): by the errors of the grid's surfaces.
    ``point_variance``: of a point's distance to its surface by the noise, as it counts for the pose: the normal matrix
    over it is the information of the beams. ``renewed``: the share of what the seen cells remember that one such scan
    replaces.
    """

    own: Float
    surfaces: Float
    point_variance: float
    renewed: float

    @property
    def covariance(self) -> Float:
        """Sigma_obs of IGO (2), shape (3, 3)."""
        return self.own + self.surfaces

    def renewed_by(self, scans: int) -> float:
        """The share of what the seen cells remember that so many scans replace."""
        return 1.0 - (1.0 - self.renewed) ** scans


@dataclass(frozen=True)
class PointErrors:
    """Variances of the points of one scan: of their noise as it counts for the pose, and of their surfaces."""

    noise: float
    surface: float

    @classmethod
    def from_sums(cls, sums: Float, noise_variance: float | None, cell_size_m: float) -> PointErrors:
        """The two from what `sum_surfaces` wrote, and from the noise (m^2) that neighbouring beams show, if they do.

        A cell hides noise: a return that noise carries into the next cell is compared with that cell's mean, so the
        distances have only a ``share`` of the variance of the noise, and as small a share of a motion shows in them.
        The share is at least that of a point that may lie anywhere in a cell. The pose's variance is that of the
        distances over the share squared, which is that of the noise over the share.
        """
        within = float(sums[kernels.WITHIN]) / max(float(sums[kernels.FREEDOM]), 1.0)
        noise = max(within if noise_variance is None else noise_variance, LEAST_NOISE_M**2)
        least = 1.0 / (1.0 + 12.0 * noise / cell_size_m**2)
        share = min(max(within / noise, least), 1.0)
        counting = max(within, noise) / share
        # Of the surfaces' mean distances, what the noise does not explain is the surfaces' own.
        surfaces = float(sums[kernels.SURFACES])
        between = float(sums[kernels.BETWEEN]) * surfaces / max(surfaces - CHOSEN, 1.0)
        explained = float(sums[kernels.EXPECTED]) * share**2 * counting
        excess = (between - explained) / (max(float(sums[kernels.WEIGHT]), 1.0) * share**2)
        return cls(counting, max(excess, 0.0) + LEAST_SURFACE_M**2)


def match_uncertainty(grid: SurfaceGrid, points: Float, pose: Float, config: MatchConfig) -> Uncertainty:
    """The uncertainty of ``points`` (n, 5) matched on ``grid`` at ``pose`` (3,). IGO (2), Sigma_obs.

    The matcher weighs all beams alike, whatever they share. So with the normal matrix N, the variance v of the noise,
    that of the surfaces s, and the sum of the Jacobians of each surface J, the covariance is
    ``v N^-1 + s N^-1 (sum J J^T) N^-1``. In directions without information, it is that of ``UNSEEN_STD_M``.
    """
    sums, deviations = np.empty(kernels.SUMS), np.empty(len(points))
    reach_m, half_weight_m = float(config.reach_m), float(config.half_weight_m)
    found = kernels.sum_surfaces(grid.tiles, points, pose, reach_m, half_weight_m, deviations, sums)
    noise = None
    if found >= FEWEST_DEVIATIONS:
        noise = kernels.core_variance(deviations[:found], MOST_DEVIATION) / DEVIATION_VARIANCE
    errors = PointErrors.from_sums(sums, noise, grid.cell_size_m)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    normal = turn.T @ sums[kernels.NORMAL + _SYMMETRIC] @ turn
    shared = turn.T @ sums[kernels.SHARED + _SYMMETRIC] @ turn
    own = se2.invert_symmetric(normal / errors.noise + np.eye(3) / UNSEEN_STD_M**2)
    surfaces = errors.surface / errors.noise**2 * (own @ shared @ own)
    returns = float(sums[kernels.RETURNS]) / max(float(sums[kernels.COUNT]), 1.0)
    return Uncertainty(own, surfaces, errors.noise, min(returns / MEAN_MEMORY, 1.0))
