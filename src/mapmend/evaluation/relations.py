"""The relation metric of Kuemmerle et al., "On Measuring the Accuracy of SLAM Algorithms", Autonomous Robots 27, 2009.

A relation is the true pose at one time relative to the pose at another. Comparing relations instead of positions needs
no alignment, and a single bend that moves everything after it counts only once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmend.errors import MapmendError
from mapmend.evaluation.stamps import StampedPoses
from mapmend.geometry.se2 import Array, between, compose

NEAREST_STAMP_WITHIN_S = 1.0
"""A relation counts if the trajectory has a stamp at most this far from each of its two times."""


@dataclass(frozen=True)
class RelationErrors:
    """How far a trajectory's relations are from the true ones; standard deviations are those of the population.

    ``is_used``: shape (total,), the relations whose two times the trajectory covers. ``translation_m`` and
    ``rotation_deg``: shape (used,), the errors of these, never negative, in the order of the relations.
    """

    translation_mean_m: float
    translation_std_m: float
    translation_median_m: float
    translation_max_m: float
    rotation_mean_deg: float
    rotation_std_deg: float
    rotation_median_deg: float
    rotation_max_deg: float
    used: int
    total: int
    translation_m: Array
    rotation_deg: Array
    is_used: NDArray[np.bool_]


def relation_errors(
    stamps_s: ArrayLike,
    poses: ArrayLike,
    t1_s: ArrayLike,
    t2_s: ArrayLike,
    relative_poses: ArrayLike,
    *,
    T_robot_laser: ArrayLike | None = None,
) -> RelationErrors:
    """The errors of a trajectory against true relations.

    The error of one relation is ``inverse(true relation) * estimated relation``: the length of its translation and the
    size of its angle. The trajectory is taken in the order of its stamps (rows of equal stamps keep their order, and
    the first of them counts); a pose between two stamps is interpolated linearly, the angle along the shorter turn. A
    relation is used if the nearest stamp to each of its times is at most 1.0 s away; beyond the trajectory's ends, up
    to there, the pose stays constant.

    ``stamps_s``: shape (n,), seconds. ``poses``: shape (n, 3), robot poses in any fixed frame. ``t1_s``, ``t2_s``:
    shape (m,). ``relative_poses``: shape (m, 3), the true pose at t2 relative to the pose at t1. ``T_robot_laser``:
    shape (3,), to be given if the relations are those of the laser and not of the robot.
    Raises MapmendError for other shapes, for numbers that are not finite, and where no relation can be used.
    """
    first, second, true = _checked_relations(t1_s, t2_s, relative_poses)
    trajectory = StampedPoses.of(stamps_s, poses)
    if T_robot_laser is not None:
        trajectory = StampedPoses(trajectory.stamps_s, compose(trajectory.poses, T_robot_laser))
    pose_at_first, first_gap_s = trajectory.at(first)
    pose_at_second, second_gap_s = trajectory.at(second)
    is_used = np.maximum(first_gap_s, second_gap_s) <= NEAREST_STAMP_WITHIN_S
    if not np.any(is_used):
        raise MapmendError(
            f"none of the {len(true)} relations (from {min(first.min(), second.min()):.6f} s to "
            f"{max(first.max(), second.max()):.6f} s) lies within {NEAREST_STAMP_WITHIN_S} s of the trajectory "
            f"({trajectory.stamps_s[0]:.6f} s to {trajectory.stamps_s[-1]:.6f} s); were both made from the same log?"
        )
    difference = between(true[is_used], between(pose_at_first[is_used], pose_at_second[is_used]))
    translation_m = np.hypot(difference[:, 0], difference[:, 1])
    rotation_deg = np.degrees(np.abs(difference[:, 2]))
    return RelationErrors(
        translation_mean_m=float(translation_m.mean()),
        translation_std_m=float(translation_m.std()),
        translation_median_m=float(np.median(translation_m)),
        translation_max_m=float(translation_m.max()),
        rotation_mean_deg=float(rotation_deg.mean()),
        rotation_std_deg=float(rotation_deg.std()),
        rotation_median_deg=float(np.median(rotation_deg)),
        rotation_max_deg=float(rotation_deg.max()),
        used=int(is_used.sum()),
        total=len(true),
        translation_m=translation_m,
        rotation_deg=rotation_deg,
        is_used=is_used,
    )


def _checked_relations(t1_s: ArrayLike, t2_s: ArrayLike, relative_poses: ArrayLike) -> tuple[Array, Array, Array]:
    first, second = np.asarray(t1_s, dtype=np.float64), np.asarray(t2_s, dtype=np.float64)
    true = np.asarray(relative_poses, dtype=np.float64)
    if first.ndim != 1 or second.shape != first.shape or true.shape != (len(first), 3):
        raise MapmendError(
            f"relations need times (m,) and relative poses (m, 3), got {first.shape}, {second.shape} and {true.shape}"
        )
    if not len(first):
        raise MapmendError("there are no relations to compare with")
    if not all(np.all(np.isfinite(numbers)) for numbers in (first, second, true)):
        raise MapmendError("the relations hold numbers that are not finite")
    return first, second, true
