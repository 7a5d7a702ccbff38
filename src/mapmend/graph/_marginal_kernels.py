"""The kernel of the sparse inverse: the entries of H^-1 where L has entries, from the factor's fronts.

Indices are unsigned for the reason given in ``_factor_kernels``.
"""

from __future__ import annotations

import numpy as np

from mapmend.graph._factor_kernels import NOWHERE, ONE, THREE, TWO, ZERO, subtract_blocks
from mapmend.graph._kernel_types import Float, Fronts
from mapmend.kernel_cache import kernel


@kernel(inline="always")
def extend(front, height, k, lower, p):
    """Extends the inverse in a front, known from row ``k + 3`` on, by three columns; these columns of L begin at ``p``.

    With Y = L_below L_kk^-1: the blocks below are ``-Z Y``, the one on the diagonal (L_kk L_kk^T)^-1 - Y^T (-Z Y).
    """
    p1, p2 = p + height, p + TWO * height
    i00, i11, i22 = lower[p], lower[p1 + ONE], lower[p2 + TWO]
    l10, l20, l21 = lower[p + ONE], lower[p + TWO], lower[p1 + TWO]
    rows, corner = height - k - THREE, k * (height + ONE)
    below, right = corner + THREE, corner + THREE * height
    for r in range(rows):
        y2 = lower[p2 + THREE + r] * i22
        y1 = (lower[p1 + THREE + r] - y2 * l21) * i11
        t = right + r * height
        front[t] = (lower[p + THREE + r] - y1 * l10 - y2 * l20) * i00
        front[t + ONE], front[t + TWO] = y1, y2
    for c in range(THREE):
        to = below + c * height
        front[to : to + rows] = 0.0
    subtract_blocks(front, below, height, front, right + THREE, right, height, rows, rows)
    # The inverse of L_kk, and of L_kk L_kk^T.
    j10 = -l10 * i00 * i11
    j21 = -l21 * i11 * i22
    j20 = -(l20 * i00 + l21 * j10) * i22
    z00, z10, z20 = i00 * i00 + j10 * j10 + j20 * j20, i11 * j10 + j21 * j20, i22 * j20
    z11, z21, z22 = i11 * i11 + j21 * j21, i22 * j21, i22 * i22
    b1, b2 = below + height, below + TWO * height
    for r in range(rows):
        t = right + r * height
        x0, x1, x2 = front[below + r], front[b1 + r], front[b2 + r]
        y0, y1, y2 = front[t], front[t + ONE], front[t + TWO]
        z00 -= y0 * x0
        z10 -= y1 * x0
        z20 -= y2 * x0
        z11 -= y1 * x1
        z21 -= y2 * x1
        z22 -= y2 * x2
        front[t], front[t + ONE], front[t + TWO] = x0, x1, x2
    c1, c2 = corner + height, corner + TWO * height
    front[corner], front[corner + ONE], front[corner + TWO] = z00, z10, z20
    front[c1], front[c1 + ONE], front[c1 + TWO] = z10, z11, z21
    front[c2], front[c2 + ONE], front[c2 + TWO] = z20, z21, z22


@kernel
def sparse_inverse(fronts: Fronts, lower: Float, work: Float) -> Float:
    """The panels of ``(L L^T)^-1``, laid out as those of L; ``work`` is as long as the factorization's.

    The equations of Takahashi, Fagan and Chen (1973), front by front from the last run to the first. A run's rows are
    all in the front of its parent, so the inverse on these rows is copied from the parent to where the update was.
    """
    firsts, first_child, next_child, row_starts, _, in_parent, panels, updates, _, _ = fronts
    runs, tallest = np.uint64(first_child.size), ZERO
    for s in range(runs):
        tallest = max(tallest, firsts[s + ONE] - firsts[s] + row_starts[s + ONE] - row_starts[s])
    front = np.empty(9 * tallest * tallest)
    inverse = np.empty(lower.size)
    for back in range(runs):
        run = runs - ONE - back
        own = THREE * (firsts[run + ONE] - firsts[run])
        below = THREE * (row_starts[run + ONE] - row_starts[run])
        height, panel, p = own + below, panels[run], updates[run]
        for c in range(own, height):
            t = c * height + own
            for r in range(below):
                front[t + r] = work[p + r]
            p += below
        k = own
        while k > ZERO:
            k -= THREE
            extend(front, height, k, lower, panel + k * (height + ONE))
        for p in range(own * height):
            inverse[panel + p] = front[p]
        child = first_child[run]
        while child != NOWHERE:
            p = updates[child]
            for b in range(row_starts[child], row_starts[child + ONE]):
                for c in range(THREE):
                    column = (THREE * in_parent[b] + c) * height
                    for a in range(row_starts[child], row_starts[child + ONE]):
                        t = column + THREE * in_parent[a]
                        work[p], work[p + ONE], work[p + TWO] = front[t], front[t + ONE], front[t + TWO]
                        p += THREE
            child = next_child[child]
    return inverse
