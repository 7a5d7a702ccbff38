"""A trajectory against a reference trajectory: absolute error after alignment, and relative error along the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmend.errors import MapmendError
from mapmend.evaluation.stamps import StampedPoses, checked_trajectory
from mapmend.geometry.se2 import Array, between, compose, wrap_angle

MAX_DIFFERENCE_S = 0.1
"""A pose has a counterpart if the reference has a stamp at most this far from it."""

END_SLACK_S = 1e-3
"""How far a pose may be outside the reference's time span: only as far as rounding to text changes a stamp."""


@dataclass(frozen=True)
class TrajectoryErrors:
    """Absolute errors after rigid alignment. ``T_reference_estimate``: shape (3,), the alignment.

    ``translation_m`` and ``rotation_deg``: shape (used,), the errors one by one, never negative;
    ``is_used``: shape (total,), the poses of the estimate that have a counterpart.
    """

    translation_rmse_m: float
    translation_mean_m: float
    translation_median_m: float
    translation_max_m: float
    rotation_mean_deg: float
    used: int
    total: int
    T_reference_estimate: Array
    translation_m: Array
    rotation_deg: Array
    is_used: NDArray[np.bool_]


@dataclass(frozen=True)
class RelativeErrors:
    """Errors of the motion over stretches of ``distance_m`` of the reference's path; ``used`` such stretches.

    ``translation_m`` and ``rotation_deg``: shape (used,), the errors one by one, never negative.
    """

    distance_m: float
    translation_rmse_m: float
    translation_mean_m: float
    rotation_mean_deg: float
    used: int
    translation_m: Array
    rotation_deg: Array


def align(points: ArrayLike, reference_points: ArrayLike) -> Array:
    """``T_reference_points``, shape (3,): the rigid motion with the least sum of squared distances, both (n, 2).

    Closed form in the plane (Horn 1987 and Umeyama 1991, without scale). If all points coincide, no angle is better
    than another and the angle is 0. Raises MapmendError for other shapes, or without points.
    """
    from_points, to_points = np.asarray(points, dtype=np.float64), np.asarray(reference_points, dtype=np.float64)
    if from_points.ndim != 2 or from_points.shape[1] != 2 or from_points.shape != to_points.shape:
        raise MapmendError(f"alignment needs two arrays (n, 2), got {from_points.shape} and {to_points.shape}")
    if not len(from_points):
        raise MapmendError("alignment needs at least one pair of points")
    from_centre, to_centre = from_points.mean(axis=0), to_points.mean(axis=0)
    a, b = from_points - from_centre, to_points - to_centre
    angle = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turn_only = np.array([0.0, 0.0, angle])
    turned_centre = compose(turn_only, np.append(from_centre, 0.0))[:2]
    return np.append(to_centre - turned_centre, wrap_angle(angle))


def trajectory_errors(
    stamps_s: ArrayLike,
    poses: ArrayLike,
    reference_stamps_s: ArrayLike,
    reference_poses: ArrayLike,
    *,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> TrajectoryErrors:
    """The absolute trajectory error (Sturm et al., IROS 2012) of (n, 3) poses against (m, 3) reference poses.

    The reference is interpolated at each stamp of the estimate: linearly between its neighbours, the angle along the
    shorter turn; of repeated reference stamps the first counts. A pose is used if the nearest reference stamp is at
    most ``max_difference_s`` away and the stamp is in the reference's time span. Then the estimate is moved onto the
    reference by the best rigid motion of its positions, without scale.
    Raises MapmendError for other shapes, for numbers that are not finite, and where no pose can be used.
    """
    stamps, estimate, reference, is_used = _associate(
        stamps_s, poses, reference_stamps_s, reference_poses, max_difference_s
    )
    alignment = align(estimate[:, :2], reference[:, :2])
    aligned = compose(alignment, estimate)
    translation_m = np.hypot(*(aligned - reference)[:, :2].T)
    rotation_deg = np.degrees(np.abs(wrap_angle(aligned[:, 2] - reference[:, 2])))
    return TrajectoryErrors(
        translation_rmse_m=float(np.sqrt(np.mean(translation_m**2))),
        translation_mean_m=float(translation_m.mean()),
        translation_median_m=float(np.median(translation_m)),
        translation_max_m=float(translation_m.max()),
        rotation_mean_deg=float(rotation_deg.mean()),
        used=len(stamps),
        total=len(is_used),
        T_reference_estimate=alignment,
        translation_m=translation_m,
        rotation_deg=rotation_deg,
        is_used=is_used,
    )


def relative_errors(
    stamps_s: ArrayLike,
    poses: ArrayLike,
    reference_stamps_s: ArrayLike,
    reference_poses: ArrayLike,
    *,
    distance_m: float = 1.0,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> RelativeErrors:
    """The relative pose error over ``distance_m``: the drift of the estimate from each pose to the one that far on.

    Poses are paired as in ``trajectory_errors`` and taken in the order of their stamps; a stretch ends at the first
    pose at which the reference has driven ``distance_m``. Its error is ``inverse(true motion) * estimated motion``.
    Raises MapmendError as ``trajectory_errors`` does, and if the reference is shorter than ``distance_m``.
    """
    if not distance_m > 0.0:
        raise MapmendError(f"distance_m must be positive, got {distance_m}")
    stamps, estimate, reference, _ = _associate(stamps_s, poses, reference_stamps_s, reference_poses, max_difference_s)
    order = np.argsort(stamps, kind="stable")
    estimate, reference = estimate[order], reference[order]
    steps_m = np.hypot(*np.diff(reference[:, :2], axis=0).T)
    path_m = np.concatenate(([0.0], np.cumsum(steps_m)))
    # Slightly less than the distance, so that rounding in the sum does not move the end to the next pose.
    ends = np.searchsorted(path_m, path_m + distance_m * (1.0 - 1e-9))
    starts = np.flatnonzero(ends < len(path_m))
    if not len(starts):
        raise MapmendError(f"the reference drives {path_m[-1]:.3f} m, less than the {distance_m} m of a stretch")
    ends = ends[starts]
    difference = between(between(reference[starts], reference[ends]), between(estimate[starts], estimate[ends]))
    translation_m = np.hypot(difference[:, 0], difference[:, 1])
    rotation_deg = np.degrees(np.abs(difference[:, 2]))
    return RelativeErrors(
        distance_m=distance_m,
        translation_rmse_m=float(np.sqrt(np.mean(translation_m**2))),
        translation_mean_m=float(translation_m.mean()),
        rotation_mean_deg=float(rotation_deg.mean()),
        used=len(starts),
        translation_m=translation_m,
        rotation_deg=rotation_deg,
    )


def _associate(
    stamps_s: ArrayLike,
    poses: ArrayLike,
    reference_stamps_s: ArrayLike,
    reference_poses: ArrayLike,
    max_difference_s: float,
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Stamps and poses of the estimate that have a counterpart, the counterparts, and which of all rows these are."""
    stamps, estimate = checked_trajectory(stamps_s, poses, "the trajectory")
    reference = StampedPoses.of(reference_stamps_s, reference_poses, "the reference")
    counterparts, gap_s = reference.at(stamps)
    begin_s, end_s = reference.stamps_s[0], reference.stamps_s[-1]
    inside = (stamps >= begin_s - END_SLACK_S) & (stamps <= end_s + END_SLACK_S)
    is_used = inside & (gap_s <= max_difference_s)
    if not np.any(is_used):
        raise MapmendError(
            f"no pose of the trajectory ({stamps.min():.6f} s to {stamps.max():.6f} s) has a reference pose within "
            f"{max_difference_s} s (the reference runs from {begin_s:.6f} s to {end_s:.6f} s)"
        )
    return stamps[is_used], estimate[is_used], counterparts[is_used], is_used
