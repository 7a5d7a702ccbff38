"""The readings of an ideal laser between walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array

JOINT_SLACK = 1e-9
"""The share of its length by which a wall is extended at its ends, so that no ray passes where two walls meet."""


def cast_rays(walls: ArrayLike, laser_poses: ArrayLike, bearings_rad: ArrayLike, max_range_m: float) -> Array:
    """Exact distances to the nearest walls, shape (n, b); ``inf`` if none is nearer than ``max_range_m``.

    ``walls``: shape (w, 4), segments ``x1 y1 x2 y2``. ``laser_poses``: shape (n, 3), in the walls' frame.
    ``bearings_rad``: shape (b,), in the laser's frame. A wall seen exactly end-on is not seen.
    Raises MapmendError for other shapes.
    """
    segments, poses = np.asarray(walls, dtype=np.float64), np.asarray(laser_poses, dtype=np.float64)
    bearings = np.asarray(bearings_rad, dtype=np.float64)
    if segments.ndim != 2 or segments.shape[1] != 4 or poses.ndim != 2 or poses.shape[1] != 3 or bearings.ndim != 1:
        raise MapmendError(
            f"need walls (w, 4), poses (n, 3) and bearings (b,), got {segments.shape}, {poses.shape}, {bearings.shape}"
        )
    ranges = np.full((len(poses), len(bearings)), np.inf)
    for k, pose in enumerate(poses):
        begin, along = segments[:, :2] - pose[:2], segments[:, 2:] - segments[:, :2]
        in_reach = _distance_from_origin(begin, along) < max_range_m
        if np.any(in_reach):
            ranges[k] = _nearest_hits(begin[in_reach], along[in_reach], bearings + pose[2])
    ranges[ranges >= max_range_m] = np.inf
    return ranges


def _nearest_hits(begin: Array, along: Array, directions_rad: Array) -> Array:
    """Distances from the origin along each direction, (b,), to the nearest of segments ``begin + s * along``.

    With u the direction: r u = begin + s along, so r = (begin x along) / (u x along), s = (begin x u) / (u x along).
    """
    x, y = np.cos(directions_rad)[:, None], np.sin(directions_rad)[:, None]
    # Products one by one instead of a matrix product, whose rounding may depend on the number of threads.
    across = x * along[:, 1] - y * along[:, 0]
    offset = begin[:, 0] * along[:, 1] - begin[:, 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance = offset / across
        share = (begin[:, 0] * y - begin[:, 1] * x) / across
        is_hit = (share >= -JOINT_SLACK) & (share <= 1.0 + JOINT_SLACK) & (distance > 0.0)
    return np.min(np.where(is_hit, distance, np.inf), axis=1)


def _distance_from_origin(begin: Array, along: Array) -> Array:
    length_squared = np.maximum(along[:, 0] ** 2 + along[:, 1] ** 2, 1e-300)
    share = np.clip(-(begin[:, 0] * along[:, 0] + begin[:, 1] * along[:, 1]) / length_squared, 0.0, 1.0)
    return np.hypot(begin[:, 0] + share * along[:, 0], begin[:, 1] + share * along[:, 1])
