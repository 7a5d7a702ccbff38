"""Kernels of the numeric factorization H = L L^T by fronts, and of solving with it.

A *run* of places is eliminated together (``_symbolic_kernels.supernodes``). Its *front* has its own block columns
first, then the rows below them. The panel of a run, those columns of L over all rows of the front, is stored by
columns: ``panel[c * height + r]`` in scalars, with its diagonal entries inverted. The *update* of a front, its Schur
complement on the rows below, is added to the parent: the multifrontal method (Duff and Reid 1983; Liu 1992).

Indices are unsigned: for a signed index, Numba checks at each access whether it counts from the end, which keeps the
loops from being vectorized (M3500: 1.8 ms instead of 1.0 ms). The products are those of ``_tile_kernels``.
"""

from __future__ import annotations

import numpy as np

from mapmend.graph._kernel_types import Float, Fronts, Int
from mapmend.graph._tile_kernels import SHORT, TALL, subtract_short, subtract_tall
from mapmend.kernel_cache import kernel

NOWHERE = np.uint64(2**64 - 1)
TALL_TILE, SHORT_TILE = np.uint64(TALL), np.uint64(SHORT)
# How many rows of a front, and columns of a panel, are processed together, so that repeated reads hit the cache.
STRIP, WIDE = np.uint64(96), np.uint64(48)
ZERO, ONE, TWO, THREE, FOUR, FIVE, SIX, EIGHT, NINE = (np.uint64(k) for k in (0, 1, 2, 3, 4, 5, 6, 8, 9))


@kernel
def subtract_blocks(target, to, pitch, panel, p, q, step, columns, rows):
    """``target[to + c * pitch + r] -= sum_k panel[p + k * step + r] * panel[q + k * step + c]`` for three columns c.

    It works in tiles whose sums stay in registers; the last rows are processed three by three, in nine sums.
    """
    while rows >= TALL_TILE:
        subtract_tall(target, to, pitch, panel, p, q, step, columns)
        to += TALL_TILE
        p += TALL_TILE
        rows -= TALL_TILE
    if rows >= SHORT_TILE:
        subtract_short(target, to, pitch, panel, p, q, step, columns)
        to += SHORT_TILE
        p += SHORT_TILE
        rows -= SHORT_TILE
    t1, t2 = to + pitch, to + TWO * pitch
    for r in range(ZERO, rows, THREE):
        s00, s10, s20, s01, s11, s21, s02, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        a, b = p + r, q
        for _ in range(columns):
            x0, x1, x2, f0, f1, f2 = panel[a], panel[a + ONE], panel[a + TWO], panel[b], panel[b + ONE], panel[b + TWO]
            s00 += x0 * f0
            s10 += x1 * f0
            s20 += x2 * f0
            s01 += x0 * f1
            s11 += x1 * f1
            s21 += x2 * f1
            s02 += x0 * f2
            s12 += x1 * f2
            s22 += x2 * f2
            a += step
            b += step
        target[to + r] -= s00
        target[to + r + ONE] -= s10
        target[to + r + TWO] -= s20
        target[t1 + r] -= s01
        target[t1 + r + ONE] -= s11
        target[t1 + r + TWO] -= s21
        target[t2 + r] -= s02
        target[t2 + r + ONE] -= s12
        target[t2 + r + TWO] -= s22


@kernel(inline="always")
def add_blocks(target, to, source, p, in_parent, first, end):
    """Adds a column of an update, three rows a block, to where its blocks are in the parent's front."""
    for a in range(first, end):
        t = to + THREE * in_parent[a]
        target[t] += source[p]
        target[t + ONE] += source[p + ONE]
        target[t + TWO] += source[p + TWO]
        p += THREE


@kernel(inline="always")
def add_update(work, p, in_parent, first, end, lower, panel, update, own, below):
    """Adds the update of a child, ``work[p:]`` over its rows ``first`` to ``end``, to its parent's panel and update."""
    step, height = THREE * (end - first), own + below
    for b in range(first, end):
        column = THREE * in_parent[b]
        for c in range(column, column + THREE):
            if column < own:
                add_blocks(lower, panel + c * height, work, p, in_parent, b, end)
            else:
                add_blocks(work, update + (c - own) * below - own, work, p, in_parent, b, end)
            p += step
        p += THREE


@kernel
def subtract_square(target, to, size, panel, p, step, columns):
    """Subtracts ``P P^T``, lower triangle only, from ``target[to:]``; P is the ``size`` rows from ``panel[p]`` on."""
    for strip in range(ZERO, size, STRIP):
        end = min(strip + STRIP, size)
        for c in range(ZERO, end, THREE):
            r = max(strip, c)
            subtract_blocks(target, to + c * size + r, size, panel, p + r, p + c, step, columns, end - r)


@kernel
def bring_up(lower, panel, k, own, height):
    """Subtracts the products of the columns before k of a panel from the next block of columns."""
    last = min(k + WIDE, own)
    for strip in range(k, height, STRIP):
        end = min(strip + STRIP, height)
        for c in range(k, min(last, end), THREE):
            r = max(strip, c)
            subtract_blocks(lower, panel + c * height + r, height, lower, panel + r, panel + c, height, k, end - r)


@kernel(inline="always")
def eliminate(values, q, smallest, lower, panel, own, height):
    """Factorizes the panel; returns how many of its scalar columns had a pivot that is large enough."""
    k, p, first = ZERO, panel, ZERO
    while k < own:
        if k == first + WIDE:
            first = k
            bring_up(lower, panel, k, own, height)
        if k > first:
            a = panel + first * height + k
            subtract_blocks(lower, p, height, lower, a, a, height, k - first, height - k)
        p1, p2 = p + height, p + TWO * height
        if not lower[p] > smallest * values[q]:
            return k
        i00 = np.sqrt(lower[p]) * (1.0 / lower[p])
        l10, l20 = lower[p + ONE] * i00, lower[p + TWO] * i00
        pivot = lower[p1 + ONE] - l10 * l10
        if not pivot > smallest * values[q + FOUR]:
            return k
        i11 = np.sqrt(pivot) * (1.0 / pivot)
        l21 = (lower[p1 + TWO] - l20 * l10) * i11
        pivot = lower[p2 + TWO] - l20 * l20 - l21 * l21
        if not pivot > smallest * values[q + EIGHT]:
            return k
        i22 = np.sqrt(pivot) * (1.0 / pivot)
        lower[p], lower[p + ONE], lower[p + TWO] = i00, l10, l20
        lower[p1], lower[p1 + ONE], lower[p1 + TWO] = 0.0, i11, l21
        lower[p2], lower[p2 + ONE], lower[p2 + TWO] = 0.0, 0.0, i22
        for r in range(THREE, height - k):
            x0 = lower[p + r] * i00
            x1 = (lower[p1 + r] - x0 * l10) * i11
            lower[p + r], lower[p1 + r] = x0, x1
            lower[p2 + r] = (lower[p2 + r] - x0 * l20 - x1 * l21) * i22
        k += THREE
        p += THREE * (height + ONE)
        q += NINE
    return k


@kernel
def factorize(
    values: Float, scale: float, smallest: float, fronts: Fronts, lower: Float, work: Float, begin: int, end: int
) -> np.int64:
    """Fills ``lower``, the panels of L, from H whose diagonal is multiplied by ``scale``; returns -1 on success.

    Otherwise it returns the place of the first pivot below ``smallest`` times its diagonal entry. ``work`` holds the
    updates. It processes the runs from ``begin`` to ``end``; their children are among them or already done.
    """
    firsts, first_child, next_child, row_starts, _, in_parent, panels, updates, block_starts, block_rows = fronts
    blocks_of_edges = NINE * np.uint64(block_starts.size - 1)
    for run in range(np.uint64(begin), np.uint64(end)):
        first, behind = firsts[run], firsts[run + ONE]
        own, below = THREE * (behind - first), THREE * (row_starts[run + ONE] - row_starts[run])
        height, panel, update = own + below, panels[run], updates[run]
        lower[panel : panel + own * height] = 0.0
        work[update : update + below * below] = 0.0
        p = panel
        for column in range(first, behind):
            t, q = p + THREE * (column - first), NINE * column
            lower[t], lower[t + ONE], lower[t + TWO] = values[q] * scale, values[q + ONE], values[q + TWO]
            t += height
            lower[t + ONE], lower[t + TWO] = values[q + FOUR] * scale, values[q + FIVE]
            lower[t + height + TWO] = values[q + EIGHT] * scale
            for block in range(block_starts[column], block_starts[column + ONE]):
                t, q = p + THREE * block_rows[block], blocks_of_edges + NINE * block
                for _ in range(3):
                    lower[t], lower[t + ONE], lower[t + TWO] = values[q], values[q + ONE], values[q + TWO]
                    t += height
                    q += THREE
            p += THREE * height
        child = first_child[run]
        while child != NOWHERE:
            a, b = row_starts[child], row_starts[child + ONE]
            add_update(work, updates[child], in_parent, a, b, lower, panel, update, own, below)
            child = next_child[child]
        done = eliminate(values, NINE * first, smallest * scale, lower, panel, own, height)
        if done < own:
            return np.int64(first + done // THREE)
        subtract_square(work, update, below, lower, panel + own, height, own)
    return np.int64(-1)


@kernel(inline="always")
def solve_lower(firsts, row_starts, rows, panels, lower, b, front):
    """Overwrites ``b`` by the solution of ``L y = b``; ``front`` is scratch memory, as long as the longest front."""
    for run in range(np.uint64(firsts.size - 1)):
        first, own = THREE * firsts[run], THREE * (firsts[run + ONE] - firsts[run])
        start, end = row_starts[run], row_starts[run + ONE]
        height = own + THREE * (end - start)
        for r in range(own):
            front[r] = b[first + r]
        for r in range(own, height):
            front[r] = 0.0
        p = panels[run]
        for k in range(ZERO, own, THREE):
            p1, p2 = p + height, p + TWO * height
            x0 = front[k] * lower[p + k]
            x1 = (front[k + ONE] - lower[p + k + ONE] * x0) * lower[p1 + k + ONE]
            x2 = (front[k + TWO] - lower[p + k + TWO] * x0 - lower[p1 + k + TWO] * x1) * lower[p2 + k + TWO]
            b[first + k], b[first + k + ONE], b[first + k + TWO] = x0, x1, x2
            for r in range(k + THREE, height):
                front[r] -= lower[p + r] * x0 + lower[p1 + r] * x1 + lower[p2 + r] * x2
            p = p2 + height
        t = own
        for a in range(start, end):
            row = THREE * rows[a]
            b[row] += front[t]
            b[row + ONE] += front[t + ONE]
            b[row + TWO] += front[t + TWO]
            t += THREE


@kernel(inline="always")
def solve_upper(firsts, row_starts, rows, panels, lower, b, front):
    """Overwrites ``b`` by the solution of ``L^T x = b``."""
    runs = np.uint64(firsts.size - 1)
    for back in range(runs):
        run = runs - ONE - back
        first, own = THREE * firsts[run], THREE * (firsts[run + ONE] - firsts[run])
        height = own
        for a in range(row_starts[run], row_starts[run + ONE]):
            row = THREE * rows[a]
            front[height], front[height + ONE], front[height + TWO] = b[row], b[row + ONE], b[row + TWO]
            height += THREE
        k, p = own, panels[run + ONE]
        while k > ZERO:
            k -= THREE
            p -= THREE * height
            p1, p2 = p + height, p + TWO * height
            x0, x1, x2 = b[first + k], b[first + k + ONE], b[first + k + TWO]
            for r in range(k + THREE, height):
                x0 -= lower[p + r] * front[r]
                x1 -= lower[p1 + r] * front[r]
                x2 -= lower[p2 + r] * front[r]
            x2 *= lower[p2 + k + TWO]
            x1 = (x1 - lower[p1 + k + TWO] * x2) * lower[p1 + k + ONE]
            x0 = (x0 - lower[p + k + ONE] * x1 - lower[p + k + TWO] * x2) * lower[p + k]
            front[k], front[k + ONE], front[k + TWO] = x0, x1, x2
            b[first + k], b[first + k + ONE], b[first + k + TWO] = x0, x1, x2


@kernel
def solve(fronts: Fronts, order: Int, lower: Float, right_sides: Float) -> None:
    """Overwrites ``right_sides``, shape (k, size), by the k solutions of ``H x = b``.

    ``order``: the vertices in the order of elimination. L has this order, the right sides have that of the vertices.
    """
    firsts, _, _, row_starts, rows, _, panels, _, _, _ = fronts
    front, b = np.empty(right_sides.shape[1]), np.empty(right_sides.shape[1])
    for k in range(len(right_sides)):
        x = right_sides[k]
        for place in range(len(order)):
            vertex = order[place]
            b[3 * place], b[3 * place + 1], b[3 * place + 2] = x[3 * vertex], x[3 * vertex + 1], x[3 * vertex + 2]
        solve_lower(firsts, row_starts, rows, panels, lower, b, front)
        solve_upper(firsts, row_starts, rows, panels, lower, b, front)
        for place in range(len(order)):
            vertex = order[place]
            x[3 * vertex], x[3 * vertex + 1], x[3 * vertex + 2] = b[3 * place], b[3 * place + 1], b[3 * place + 2]
