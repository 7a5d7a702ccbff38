"""Kernel of the agreement of loops: which loops another loop nearby confirms, along the chain of the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

TURN = 2.0 * np.pi


@kernel
def add_carried(total: Float, pose: Float, covariance: Float) -> None:
    """``total += A covariance A^T``, A the adjoint of the pose."""
    x, y, c, s = pose[0], pose[1], np.cos(pose[2]), np.sin(pose[2])
    carried = np.empty((3, 3))
    for k in range(3):
        carried[0, k] = c * covariance[0, k] - s * covariance[1, k] + y * covariance[2, k]
        carried[1, k] = s * covariance[0, k] + c * covariance[1, k] - x * covariance[2, k]
        carried[2, k] = covariance[2, k]
    for k in range(3):
        total[k, 0] += c * carried[k, 0] - s * carried[k, 1] + y * carried[k, 2]
        total[k, 1] += s * carried[k, 0] + c * carried[k, 1] - x * carried[k, 2]
        total[k, 2] += carried[k, 2]


@kernel
def relative(a: Float, b: Float) -> tuple[float, float, float]:
    """``a^-1 b`` of two poses; the angle is not wrapped."""
    c, s = np.cos(a[2]), np.sin(a[2])
    x, y = b[0] - a[0], b[1] - a[1]
    return c * x + s * y, c * y - s * x, b[2] - a[2]


@kernel
def squared_length(error: Float, s: Float) -> float:
    """``error^T s^-1 error``, s symmetric and positive definite; infinite where rounding made it indefinite."""
    p0 = s[0, 0]
    l1, l2 = s[1, 0] / p0, s[2, 0] / p0
    p1 = s[1, 1] - l1 * s[1, 0]
    mixed = s[2, 1] - l2 * s[1, 0]
    p2 = s[2, 2] - l2 * s[2, 0] - mixed * mixed / p1
    if not (p0 > 0.0 and p1 > 0.0 and p2 > 0.0):
        return np.inf
    y1 = error[1] - l1 * error[0]
    y2 = error[2] - l2 * error[0] - mixed / p1 * y1
    return error[0] * error[0] / p0 + y1 * y1 / p1 + y2 * y2 / p2


@kernel
def confirmed(
    chain: Float,
    path_m: Float,
    spread: Float,
    ends: Int,
    measured: Float,
    covariances: Float,
    reach_m: float,
    bound: float,
) -> Bool:
    """Which loops agree with another one whose ends are at most ``reach_m`` along the chain from theirs, shape (k,).

    ``chain``: the poses along the chain, shape (n, 3), and ``path_m`` its length up to each, (n,). ``spread``: the
    covariance of its steps in the frame of the map, summed up to each node, shape (n, 3, 3). ``ends``: shape (k, 2),
    sorted by the first, which is the earlier node; ``measured``, ``covariances``: the pose of the second in the frame
    of the first, and its covariance in its own frame.

    Loop p from i to j predicts loop q from k to m along the chain: ``T_k_i T_i_j T_j_m``. The difference to what q
    measures is weighed by the covariances of both loops and of the two pieces of the chain, all carried into the frame
    of m.
    """
    count = len(ends)
    found = np.zeros(count, np.bool_)
    total, error, poses, parts = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 3, 3))
    for p in range(count):
        i, j = ends[p, 0], ends[p, 1]
        q = p + 1
        while q < count and path_m[ends[q, 0]] <= path_m[i] + reach_m:
            k, m = ends[q, 0], ends[q, 1]
            if abs(path_m[m] - path_m[j]) <= reach_m and not (k == i and m == j) and not (found[p] and found[q]):
                # T_k_j, then the prediction of T_k_m and of m in the frame of q's measurement.
                x, y, angle = relative(chain[k], chain[i])
                c, s = np.cos(angle), np.sin(angle)
                x += c * measured[p, 0] - s * measured[p, 1]
                y += s * measured[p, 0] + c * measured[p, 1]
                angle += measured[p, 2]
                c, s = np.cos(angle), np.sin(angle)
                dx, dy, turn = relative(chain[j], chain[m])
                x += c * dx - s * dy - measured[q, 0]
                y += s * dx + c * dy - measured[q, 1]
                angle += turn - measured[q, 2]
                c, s = np.cos(measured[q, 2]), np.sin(measured[q, 2])
                error[0], error[1] = c * x + s * y, c * y - s * x
                error[2] = angle - TURN * np.floor(angle / TURN + 0.5)

                # Loop p, the chain from j to m, and the one from k to i, carried through loop p: T_m_j T_i_j^-1
                # T_i_map.
                x, y, angle = relative(chain[m], chain[j])
                poses[0, 0], poses[0, 1], poses[0, 2] = x, y, angle
                parts[0] = covariances[p]
                c, s = np.cos(chain[m, 2]), np.sin(chain[m, 2])
                poses[1, 0], poses[1, 1] = -c * chain[m, 0] - s * chain[m, 1], s * chain[m, 0] - c * chain[m, 1]
                poses[1, 2] = -chain[m, 2]
                parts[1] = spread[max(j, m)] - spread[min(j, m)]
                angle -= measured[p, 2]
                c, s = np.cos(angle), np.sin(angle)
                x -= c * measured[p, 0] - s * measured[p, 1]
                y -= s * measured[p, 0] + c * measured[p, 1]
                angle -= chain[i, 2]
                c, s = np.cos(angle), np.sin(angle)
                poses[2, 0], poses[2, 1] = x - c * chain[i, 0] + s * chain[i, 1], y - s * chain[i, 0] - c * chain[i, 1]
                poses[2, 2] = angle
                parts[2] = spread[max(i, k)] - spread[min(i, k)]
                total[:] = covariances[q]
                for part in range(3):
                    add_carried(total, poses[part], parts[part])
                if squared_length(error, total) <= bound:
                    found[p] = found[q] = True
            q += 1
    return found
