"""The odometry model: how uncertain a reported motion is, and hypotheses drawn from it. IGO section III-A, eq. (1)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmend.config import MotionConfig
from mapmend.geometry import se2

Float = NDArray[np.float64]

# The standard deviation of a normal distribution over the median of its absolute values.
STD_PER_MEDIAN = 1.4826


def odometry_std(motion: Float, config: MotionConfig) -> tuple[float, float]:
    """Standard deviations of a reported ``motion`` (3,): of the translation in any direction (m), of the turn (rad)."""
    way, turn = math.hypot(motion[0], motion[1]), abs(float(motion[2]))
    translation = math.hypot(config.translation_std_per_m * way, config.translation_std_per_rad * turn)
    rotation = math.hypot(config.rotation_std_per_m * way, config.rotation_std_per_rad * turn)
    return max(translation, config.min_translation_std_m), max(rotation, config.min_rotation_std_rad)


def odometry_covariance(motion: Float, config: MotionConfig) -> Float:
    """Sigma_odo of a reported ``motion`` (3,), in the frame of its end, shape (3, 3): IGO eq. (1)."""
    translation, rotation = odometry_std(motion, config)
    return np.diag([translation**2, translation**2, rotation**2])


def draw_hypotheses(predicted: Float, covariance: Float, count: int, random: np.random.Generator) -> Float:
    """``count`` poses about ``predicted`` (3,) with ``covariance`` (3, 3) in its frame; shape (count, 3)."""
    steps = random.multivariate_normal(np.zeros(3), covariance, size=count)
    return se2.compose(predicted, steps)
