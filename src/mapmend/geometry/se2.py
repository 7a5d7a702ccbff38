"""SE(2) on plain arrays: a pose is ``(x, y, theta)`` in metres and radians, the last axis of any array.

Covariances are those of a perturbation on the right, in the frame of the pose itself: ``T_true = T * d`` with
``d ~ N(0, covariance)``. They are then composed with the adjoint (with the lever arm that IGO (4) and (6) leave out).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def wrap_angle(angle: ArrayLike) -> Array:
    """The same angle in [-pi, pi), elementwise."""
    return np.asarray((np.asarray(angle, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi)


def _wrap_one(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def to_the_nanometre(pose: ArrayLike) -> Array:
    """A pose (3,) or poses (n, 3) in whole nanometres and nanoradians, angles in [-pi, pi).

    One drive gives one map: a bag keeps angles as quaternions, from which they come back with another 16th digit than
    from a CARMEN log. Over thousands of matches and decisions about loops that alone grew to 5 cm on intel.
    """
    poses = np.asarray(pose, dtype=np.float64)
    if poses.ndim == 1:
        x, y, theta = poses.tolist()
        return np.array([round(one * 1e9) / 1e9 for one in (x, y, _wrap_one(theta))], dtype=np.float64)
    return np.column_stack((poses[:, :2], wrap_angle(poses[:, 2]))).round(9)


def _compose_one(a: list[float], b: list[float]) -> Array:
    """For a single pose, as the front end needs it for every scan: arrays would take twenty times as long."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return np.array(
        (a[0] + cos * b[0] - sin * b[1], a[1] + sin * b[0] + cos * b[1], _wrap_one(a[2] + b[2])), dtype=np.float64
    )


def _inverse_one(a: list[float]) -> Array:
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return np.array((-cos * a[0] - sin * a[1], sin * a[0] - cos * a[1], _wrap_one(-a[2])), dtype=np.float64)


def compose(T_a_b: ArrayLike, T_b_c: ArrayLike) -> Array:
    """``T_a_c`` for poses of shape (..., 3); the leading axes broadcast."""
    a, b = np.asarray(T_a_b, dtype=np.float64), np.asarray(T_b_c, dtype=np.float64)
    if a.ndim == 1 and b.ndim == 1:
        return _compose_one(a.tolist(), b.tolist())
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        (
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ),
        axis=-1,
    )


def inverse(T_a_b: ArrayLike) -> Array:
    """``T_b_a`` for poses of shape (..., 3)."""
    a = np.asarray(T_a_b, dtype=np.float64)
    if a.ndim == 1:
        return _inverse_one(a.tolist())
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        (
            -cos * a[..., 0] - sin * a[..., 1],
            sin * a[..., 0] - cos * a[..., 1],
            wrap_angle(-a[..., 2]),
        ),
        axis=-1,
    )


def between(T_a_b: ArrayLike, T_a_c: ArrayLike) -> Array:
    """``T_b_c``, the pose of c in the frame of b, for poses of shape (..., 3)."""
    return compose(inverse(T_a_b), T_a_c)


def transform_points(T_a_b: ArrayLike, points_b: ArrayLike) -> Array:
    """Points of shape (..., n, 2), given in frame b, in frame a; the pose ``T_a_b`` has shape (..., 3)."""
    pose, points = np.asarray(T_a_b, dtype=np.float64), np.asarray(points_b, dtype=np.float64)
    cos, sin = np.cos(pose[..., 2, None]), np.sin(pose[..., 2, None])
    return np.stack(
        (
            pose[..., 0, None] + cos * points[..., 0] - sin * points[..., 1],
            pose[..., 1, None] + sin * points[..., 0] + cos * points[..., 1],
        ),
        axis=-1,
    )


def adjoint(T_a_b: ArrayLike) -> Array:
    """The matrix A, shape (..., 3, 3), with ``T * d = (A d) * T`` for a small d."""
    pose = np.asarray(T_a_b, dtype=np.float64)
    if pose.ndim == 1:
        x, y, theta = pose.tolist()
        c, s = math.cos(theta), math.sin(theta)
        return np.array(((c, -s, y), (s, c, -x), (0.0, 0.0, 1.0)))
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = (
        np.stack((cos, -sin, pose[..., 1]), axis=-1),
        np.stack((sin, cos, -pose[..., 0]), axis=-1),
        np.stack((zero, zero, one), axis=-1),
    )
    return np.stack(rows, axis=-2)


def invert_symmetric(matrix: Array) -> Array:
    """The inverse of one symmetric positive definite 3 x 3 matrix, by cofactors of its upper half.

    For one small matrix it takes a tenth of the library's time. Raises ``ZeroDivisionError`` if it is exactly singular.
    """
    (a, b, c), (_, d, e), (_, _, f) = matrix.tolist()
    first, second, third = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * first + b * second + c * third)
    fourth, fifth, sixth = a * f - c * c, b * c - a * e, a * d - b * b
    return scale * np.array(((first, second, third), (second, fourth, fifth), (third, fifth, sixth)))


def compose_covariance(covariance_a_b: ArrayLike, T_b_c: ArrayLike, covariance_b_c: ArrayLike) -> Array:
    """The covariance of ``T_a_b * T_b_c``, shape (..., 3, 3), for independent factors: IGO (6) with its lever arm."""
    carry = adjoint(inverse(T_b_c))
    first = np.asarray(covariance_a_b, dtype=np.float64)
    return np.asarray(carry @ first @ np.swapaxes(carry, -1, -2) + np.asarray(covariance_b_c, dtype=np.float64))


def inverse_covariance(T_a_b: ArrayLike, covariance_a_b: ArrayLike) -> Array:
    """The covariance of ``T_b_a``, shape (..., 3, 3)."""
    carry = adjoint(T_a_b)
    inner = np.asarray(covariance_a_b, dtype=np.float64)
    return np.asarray(carry @ inner @ np.swapaxes(carry, -1, -2))


def interpolate(T_a_b: ArrayLike, T_a_c: ArrayLike, share: ArrayLike) -> Array:
    """The pose at ``share`` (0: b, 1: c) of the straight line from b to c, the angle along the shorter turn."""
    b, c = np.asarray(T_a_b, dtype=np.float64), np.asarray(T_a_c, dtype=np.float64)
    s = np.asarray(share, dtype=np.float64)[..., None]
    step = c - b
    step = np.concatenate((step[..., :2], wrap_angle(step[..., 2:])), axis=-1)
    pose = b + s * step
    return np.concatenate((pose[..., :2], wrap_angle(pose[..., 2:])), axis=-1)
