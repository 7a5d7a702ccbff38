"""One scan on a grid of other scans: arrays in; pose, covariance and score out. What ``mapmend.match`` is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmend.config import REACH_CELLS, Config, require_config
from mapmend.errors import MapmendError
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.gauss_newton import NO_PRIOR, SurfaceMatcher, prior_at
from mapmend.scan import LaserGeometry, Scans, scans_of
from mapmend.scan_graph.points import ScanPoints

Float = NDArray[np.float64]

DEFAULT_CONFIG = Config()


@dataclass(frozen=True)
class ScanMatch:
    """The result of `match`.

    ``pose``: (3,), ``T_grid_robot``. ``covariance``: (3, 3), of the match alone, without the prior, in the frame of the
    pose; where no surface holds the pose, 10 m and 10 rad (standard deviations). ``score``: the share of the points
    that found a surface within half of ``match.reach_m``. ``converged``: whether the last step was shorter than
    ``match.convergence_m``; a match that has converged may still be wrong: see the score.
    """

    pose: Float
    covariance: Float
    score: float
    converged: bool


def grid_of(
    ranges_m: ArrayLike, geometry: LaserGeometry, poses: ArrayLike, config: Config = DEFAULT_CONFIG
) -> SurfaceGrid:
    """A grid of n scans to match on, in cells of ``grid.cell_size_m``.

    ``ranges_m``: (n, beams), metres; inf for no return, nan for an unusable reading. ``poses``: (n, 3),
    ``T_grid_robot``. Raises MapmendError for other shapes and for numbers that are not finite.
    """
    require_config(config)
    scans = scans_of(ranges_m, geometry)
    at = _finite(poses, "poses", (len(scans), 3))
    grid, points = SurfaceGrid(config.grid.cell_size_m), ScanPoints(scans, config.scan)
    for k, pose in enumerate(at):
        grid.insert(points.of(k), points.laser_origin(k), pose)
    return grid


def match(
    grid: SurfaceGrid,
    ranges_m: ArrayLike,
    geometry: LaserGeometry,
    start: ArrayLike,
    *,
    start_covariance: ArrayLike | None = None,
    config: Config = DEFAULT_CONFIG,
) -> ScanMatch:
    """Matches one scan on a grid by Gauss-Newton, from ``start`` (3,), ``T_grid_robot``. IGO (2) and its [2].

    ``grid``: from `grid_of`. ``ranges_m``: (beams,), metres; inf for no return, nan for an unusable reading.
    ``start_covariance``: (3, 3), in the frame of ``start``, where the start is a measurement that counts, such as
    odometry; by default it is only where the search begins. The start has to be within some decimetres and tenths of a
    radian of the pose (``match.reach_m``, ``match.widening``). Raises MapmendError for other shapes, for numbers that
    are not finite, for a scan without returns, and for a ``match.reach_m`` beyond the 4 cells that a grid knows.
    """
    require_config(config)
    known_m = REACH_CELLS * grid.cell_size_m
    if config.match.reach_m > known_m * (1.0 + 1e-9):
        raise MapmendError(f"match.reach_m is {config.match.reach_m:g}; this grid's cells allow {known_m:g} at most")
    pose = _finite(start, "start", (3,))
    prior = NO_PRIOR if start_covariance is None else prior_at(pose, _covariance(start_covariance))
    points = _points(scans_of(np.asarray(ranges_m)[None], geometry), config)
    matcher = SurfaceMatcher(config.match)
    found = matcher.match(grid, points, pose, prior)
    return ScanMatch(found.pose, matcher.uncertainty(grid, points, found).covariance, found.score, found.converged)


def _points(scan: Scans, config: Config) -> Float:
    points = ScanPoints(scan, config.scan).of(0)
    if not len(points):
        limits = f"{config.scan.min_range_m:g} m and {config.scan.max_range_m:g} m"
        raise MapmendError(f"the scan has no return between {limits}; nothing can be matched")
    return points


def _covariance(covariance: ArrayLike) -> Float:
    given = _finite(covariance, "start_covariance", (3, 3))
    if not np.allclose(given, given.T) or np.linalg.eigvalsh(given)[0] <= 0.0:
        raise MapmendError("start_covariance must be symmetric and positive definite")
    return given


def _finite(values: ArrayLike, name: str, shape: tuple[int, ...]) -> Float:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise MapmendError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.all(np.isfinite(array)):
        raise MapmendError(f"{name} must be finite")
    return array
