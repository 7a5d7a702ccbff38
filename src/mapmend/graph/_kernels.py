"""Kernels of the pose-graph back end: linearization and the motion of the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

Float = NDArray[np.float64]
Int = NDArray[np.int64]

TURN = 2.0 * np.pi
# "contract": a product and a sum are rounded once, where the machine can.


@kernel(fastmath={"contract"})
def linearize(
    poses: Float,
    edges: Int,
    measurements: Float,
    information: Float,
    places: Int,
    block_of_edge: Int,
    count: int,
    values: Float,
) -> tuple[float, Float]:
    """``chi2`` and the gradient ``g = sum J^T Omega e``; fills ``values``, the blocks of ``H = sum J^T Omega J``.

    ``places``: shape (n,), -1 where a node is fixed. H is given as the ``count`` diagonal blocks, then the blocks below
    the diagonal, which ``block_of_edge`` counts; each by columns.

    With ``J_j`` the derivative by a motion of j, that by a motion of i is ``-J_j A``, A the adjoint of ``T_j_i``. So
    ``W = J_j^T Omega J_j`` is all that is needed: ``H_jj = W``, ``H_ji = -W A``, ``H_ii = A^T W A``.
    """
    below = 9 * count
    values.fill(0.0)
    gradient = np.zeros(3 * count)
    turns = np.empty((len(poses), 2))
    for node in range(len(poses)):
        turns[node, 0], turns[node, 1] = np.cos(poses[node, 2]), np.sin(poses[node, 2])
    chi2 = 0.0
    for k in range(len(edges)):
        i, j = edges[k, 0], edges[k, 1]
        cos_i, sin_i, cos_j, sin_j = turns[i, 0], turns[i, 1], turns[j, 0], turns[j, 1]
        cos_m, sin_m = np.cos(measurements[k, 2]), np.sin(measurements[k, 2])
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        x = cos_i * dx + sin_i * dy - measurements[k, 0]
        y = cos_i * dy - sin_i * dx - measurements[k, 1]
        e0, e1 = cos_m * x + sin_m * y, cos_m * y - sin_m * x
        e2 = poses[j, 2] - poses[i, 2] - measurements[k, 2]
        e2 -= TURN * np.floor(e2 / TURN + 0.5)
        # The turn and the lever of T_j_i, and the turn of the error.
        c, s = cos_j * cos_i + sin_j * sin_i, cos_j * sin_i - sin_j * cos_i
        lever_x, lever_y = -cos_j * dx - sin_j * dy, sin_j * dx - cos_j * dy
        cos_e, sin_e = c * cos_m - s * sin_m, -s * cos_m - c * sin_m

        o = information[k]
        f0 = o[0, 0] * e0 + o[0, 1] * e1 + o[0, 2] * e2
        f1 = o[0, 1] * e0 + o[1, 1] * e1 + o[1, 2] * e2
        f2 = o[0, 2] * e0 + o[1, 2] * e1 + o[2, 2] * e2
        chi2 += e0 * f0 + e1 * f1 + e2 * f2
        g0, g1 = cos_e * f0 + sin_e * f1, cos_e * f1 - sin_e * f0
        a0, a1 = cos_e * o[0, 0] + sin_e * o[0, 1], cos_e * o[0, 1] + sin_e * o[1, 1]
        b0, b1 = cos_e * o[0, 1] - sin_e * o[0, 0], cos_e * o[1, 1] - sin_e * o[0, 1]
        w00, w01, w11 = cos_e * a0 + sin_e * a1, cos_e * a1 - sin_e * a0, cos_e * b1 - sin_e * b0
        w02, w12, w22 = cos_e * o[0, 2] + sin_e * o[1, 2], cos_e * o[1, 2] - sin_e * o[0, 2], o[2, 2]
        # M = W A
        m00, m01, m02 = w00 * c + w01 * s, w01 * c - w00 * s, w00 * lever_y - w01 * lever_x + w02
        m10, m11, m12 = w01 * c + w11 * s, w11 * c - w01 * s, w01 * lever_y - w11 * lever_x + w12
        m20, m21, m22 = w02 * c + w12 * s, w12 * c - w02 * s, w02 * lever_y - w12 * lever_x + w22

        place_i, place_j = places[i], places[j]
        if place_j >= 0:
            gradient[3 * place_j] += g0
            gradient[3 * place_j + 1] += g1
            gradient[3 * place_j + 2] += f2
            block = values[9 * place_j : 9 * place_j + 9]
            block[0] += w00
            block[1] += w01
            block[2] += w02
            block[3] += w01
            block[4] += w11
            block[5] += w12
            block[6] += w02
            block[7] += w12
            block[8] += w22
        if place_i >= 0:
            gradient[3 * place_i] -= c * g0 + s * g1
            gradient[3 * place_i + 1] -= c * g1 - s * g0
            gradient[3 * place_i + 2] -= lever_y * g0 - lever_x * g1 + f2
            block = values[9 * place_i : 9 * place_i + 9]
            h01, h02, h12 = c * m01 + s * m11, c * m02 + s * m12, c * m12 - s * m02
            block[0] += c * m00 + s * m10
            block[1] += h01
            block[2] += h02
            block[3] += h01
            block[4] += c * m11 - s * m01
            block[5] += h12
            block[6] += h02
            block[7] += h12
            block[8] += lever_y * m02 - lever_x * m12 + m22
        if place_i >= 0 and place_j >= 0:
            first = below + 9 * block_of_edge[k]
            block = values[first : first + 9]
            block[0] -= m00
            block[4] -= m11
            block[8] -= m22
            if place_i > place_j:
                m01, m02, m10, m12, m20, m21 = m10, m20, m01, m21, m02, m12
            block[1] -= m10
            block[2] -= m20
            block[3] -= m01
            block[5] -= m21
            block[6] -= m02
            block[7] -= m12
    ordered, first = np.empty(3 * count), 0
    for node in range(len(poses)):
        if places[node] >= 0:
            for r in range(3):
                ordered[first + r] = gradient[3 * places[node] + r]
            first += 3
    return chi2, ordered


@kernel
def move(poses: Float, nodes: Int, step: Float) -> Float:
    """``X * d`` of the ``nodes``, whose motions ``d`` follow each other in ``step``; the other nodes stay."""
    moved = poses.copy()
    for k in range(len(nodes)):
        node = nodes[k]
        cos, sin = np.cos(poses[node, 2]), np.sin(poses[node, 2])
        moved[node, 0] += cos * step[3 * k] - sin * step[3 * k + 1]
        moved[node, 1] += sin * step[3 * k] + cos * step[3 * k + 1]
        angle = poses[node, 2] + step[3 * k + 2]
        moved[node, 2] = angle - TURN * np.floor(angle / TURN + 0.5)
    return moved
