"""Exact covariances of an optimized graph, from the factor of its information matrix.

After loops have closed, IGO uses the approximation of its reference [22]; these are the exact entries of ``H^-1``. All
are covariances of motions in the pose's own frame, metres and radians (``geometry.se2``).
"""

from __future__ import annotations

import numpy as np

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.pose_graph import Float, Int
from mapmend.graph.system import Factorization


def marginals(factorization: Factorization) -> Float:
    """The covariance of every node, shape (n, 3, 3); zero where a node is fixed.

    One pass of the sparse inverse subset (Takahashi equations) for all nodes, in the time of a few factorizations.
    """
    from mapmend.graph import _marginal_kernels

    elimination, unknowns = factorization.elimination, factorization.unknowns
    covariances = np.zeros((len(unknowns), 3, 3))
    work = np.empty(elimination.work_size)
    inverse = _marginal_kernels.sparse_inverse(elimination.fronts, factorization.lower, work)
    covariances[unknowns >= 0] = inverse[elimination.diagonal_blocks()[elimination.places]]
    return covariances


def cross_covariances(factorization: Factorization, node: int) -> Float:
    """``Sigma_{k, node}`` of every node k, shape (n, 3, 3), by three solves; zero where either is fixed.

    ``node`` is a row number; raises ``MapmendError`` if it does not exist.
    """
    unknowns = factorization.unknowns
    if not 0 <= node < len(unknowns):
        raise MapmendError(f"no node {node} in a graph of {len(unknowns)}")
    covariances = np.zeros((len(unknowns), 3, 3))
    if unknowns[node] >= 0:
        right_sides = np.zeros((factorization.size, 3))
        right_sides[3 * unknowns[node] + np.arange(3), np.arange(3)] = 1.0
        covariances[unknowns >= 0] = factorization.solve(right_sides).reshape(-1, 3, 3)
    return covariances


def relative_covariances(
    factorization: Factorization, poses: Float, covariances: Float, node: int, others: Int | None = None
) -> Float:
    """The covariance of ``T_l_i = X_l^-1 X_i`` in the frame of i = ``node``, for each l of ``others`` (all, if None).

    The S of IGO eq. (4), exact for closed loops too: ``Sigma_ii + A Sigma_ll A^T - A Sigma_li - Sigma_il A^T`` with A
    the adjoint of ``T_i_l``, which carries a motion of l into the frame of i. ``poses``, shape (n, 3), and
    ``covariances``, shape (n, 3, 3), from ``marginals``, are of all nodes; ``others`` are row numbers, shape (k,).
    Returns shape (k, 3, 3).
    """
    across = cross_covariances(factorization, node)
    rows = np.arange(len(poses)) if others is None else np.asarray(others, dtype=np.int64)
    carry = se2.adjoint(se2.between(poses[node], poses[rows]))
    turned = np.swapaxes(carry, -1, -2)
    mixed = carry @ across[rows]
    relative = across[node] + carry @ covariances[rows] @ turned - mixed - np.swapaxes(mixed, -1, -2)
    return np.asarray(0.5 * (relative + np.swapaxes(relative, -1, -2)))


def joint_covariance(factorization: Factorization, first: int, second: int) -> Float:
    """The covariance of two nodes together, shape (6, 6): ``[[S_aa, S_ab], [S_ba, S_bb]]``; row numbers.

    Raises ``MapmendError`` if one of them does not exist.
    """
    by_first, by_second = (cross_covariances(factorization, node) for node in (first, second))
    joint = np.block([[by_first[first], by_second[first]], [by_first[second], by_second[second]]])
    return np.asarray(0.5 * (joint + joint.T))
