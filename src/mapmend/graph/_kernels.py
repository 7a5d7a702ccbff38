"""Kernels of the pose-graph back end: linearization, triangular solves and the sparse inverse subset."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@njit(cache=True, nogil=True)
def linearize(
    poses: Float,
    edges: Int,
    measurements: Float,
    information: Float,
    unknowns: Int,
    column_starts: Int,
    block_ranks: Int,
) -> tuple[float, Float, Float]:
    """``chi2``, the upper triangle of ``H = sum J^T Omega J`` and the gradient ``g = sum J^T Omega e``.

    ``unknowns``, ``column_starts`` and ``block_ranks`` are those of ``System``: the 3x3 block of an edge begins three
    rows times its rank down from the head of its column; the diagonal block ends its column.
    """
    size = len(column_starts) - 1
    values = np.zeros(column_starts[size])
    gradient = np.zeros(size)
    error = np.empty(3)
    jacobians = np.zeros((2, 3, 3))
    weighted = np.empty((2, 3, 3))
    rows = np.empty(2, np.int64)
    chi2 = 0.0
    for k in range(len(edges)):
        i, j = edges[k, 0], edges[k, 1]
        cos_i, sin_i = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        cos_m, sin_m = np.cos(measurements[k, 2]), np.sin(measurements[k, 2])
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        x, y = cos_i * dx + sin_i * dy, cos_i * dy - sin_i * dx
        dx, dy = x - measurements[k, 0], y - measurements[k, 1]
        error[0] = cos_m * dx + sin_m * dy
        error[1] = cos_m * dy - sin_m * dx
        error[2] = (poses[j, 2] - poses[i, 2] - measurements[k, 2] + np.pi) % (2.0 * np.pi) - np.pi
        cos_e, sin_e = np.cos(error[2]), np.sin(error[2])
        # A motion of i in its own frame carries j the other way, with the lever arm (x, y); a motion of j is turned
        # into the frame of the measured pose.
        jacobians[0, 0, 0], jacobians[0, 0, 1] = -cos_m, -sin_m
        jacobians[0, 1, 0], jacobians[0, 1, 1] = sin_m, -cos_m
        jacobians[0, 0, 2], jacobians[0, 1, 2] = cos_m * y - sin_m * x, -sin_m * y - cos_m * x
        jacobians[0, 2, 2] = -1.0
        jacobians[1, 0, 0], jacobians[1, 0, 1] = cos_e, -sin_e
        jacobians[1, 1, 0], jacobians[1, 1, 1] = sin_e, cos_e
        jacobians[1, 2, 2] = 1.0

        rows[0], rows[1] = unknowns[i], unknowns[j]
        for end in range(2):
            for r in range(3):
                for c in range(3):
                    total = 0.0
                    for s in range(3):
                        total += information[k, r, s] * jacobians[end, s, c]
                    weighted[end, r, c] = total
        for r in range(3):
            for s in range(3):
                chi2 += error[r] * information[k, r, s] * error[s]

        for end in range(2):
            if rows[end] < 0:
                continue
            first = 3 * rows[end]
            for c in range(3):
                for s in range(3):
                    gradient[first + c] += weighted[end, s, c] * error[s]
                last = column_starts[first + c + 1] - 1
                for r in range(c + 1):
                    for s in range(3):
                        values[last - c + r] += jacobians[end, s, r] * weighted[end, s, c]
        if rows[0] < 0 or rows[1] < 0:
            continue
        upper, right = (0, 1) if rows[0] < rows[1] else (1, 0)
        for c in range(3):
            head = column_starts[3 * rows[right] + c] + 3 * block_ranks[k]
            for r in range(3):
                for s in range(3):
                    values[head + r] += jacobians[upper, s, r] * weighted[right, s, c]
    return chi2, values, gradient


@njit(cache=True, nogil=True)
def solve(starts: Int, rows: Int, lower: Float, diagonal: Float, right_sides: Float) -> None:
    """Overwrites ``right_sides``, shape (k, size), by the k solutions of ``(I + L) D (I + L)^T x = b``."""
    for b in right_sides:
        for j in range(len(b)):
            known = b[j]
            for p in range(starts[j], starts[j + 1]):
                b[rows[p]] -= lower[p] * known
        for j in range(len(b) - 1, -1, -1):
            total = b[j] / diagonal[j]
            for p in range(starts[j], starts[j + 1]):
                total -= lower[p] * b[rows[p]]
            b[j] = total


@njit(cache=True, nogil=True)
def sparse_inverse(starts: Int, rows: Int, lower: Float, diagonal: Float) -> tuple[Float, Float]:
    """The entries of ``((I + L) D (I + L)^T)^-1`` on the pattern of L, and its diagonal.

    The equations of Takahashi, Fagan and Chen (1973), from the last column to the first: column j of the inverse is
    ``-Z[S, S] L[S, j]`` on its own rows S. What it needs is known by then, for the rows of S below r are among the
    rows of column r. The rows of a column rise.
    """
    size = len(starts) - 1
    inverse = np.zeros(len(lower))
    inverse_diagonal = np.empty(size)
    product = np.zeros(size)
    for j in range(size - 1, -1, -1):
        first, end = starts[j], starts[j + 1]
        count = end - first
        product[:count] = 0.0
        for a in range(count):
            r = rows[first + a]
            own = lower[first + a]
            total = inverse_diagonal[r] * own
            q = starts[r]
            for b in range(a + 1, count):
                row = rows[first + b]
                while rows[q] != row:
                    q += 1
                total += inverse[q] * lower[first + b]
                product[b] += inverse[q] * own
            product[a] += total
        corner = 1.0 / diagonal[j]
        for a in range(count):
            inverse[first + a] = -product[a]
            corner += lower[first + a] * product[a]
        inverse_diagonal[j] = corner
    return inverse, inverse_diagonal


@njit(cache=True, nogil=True)
def diagonal_blocks(starts: Int, rows: Int, inverse: Float, inverse_diagonal: Float, places: Int) -> Float:
    """The 3x3 diagonal blocks of the inverse, shape (size / 3, 3, 3); row u of H was ordered to ``places[u]``."""
    blocks = np.empty((len(places) // 3, 3, 3))
    for node in range(len(blocks)):
        for r in range(3):
            blocks[node, r, r] = inverse_diagonal[places[3 * node + r]]
            for c in range(r):
                column = min(places[3 * node + r], places[3 * node + c])
                row = max(places[3 * node + r], places[3 * node + c])
                p = starts[column]
                while rows[p] != row:
                    p += 1
                blocks[node, r, c] = blocks[node, c, r] = inverse[p]
    return blocks
