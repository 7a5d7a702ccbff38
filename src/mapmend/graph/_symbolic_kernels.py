"""Kernels of the symbolic analysis: what is eliminated together, what fills in, and where all numbers are stored.

As in ``_ordering_kernels``, a node's three unknowns count as one, and its *place* is its position in the order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

Int = NDArray[np.int64]


@kernel
def supernodes(parents: Int, blocks: Int, narrow: int, zero_share: float) -> tuple[Int, Int]:
    """Runs of places that are eliminated together: the first place of each (and the end), and the parent of each.

    ``parents`` and ``blocks`` in postorder. A column joins the next one if both have the same rows. A run joins its
    parent, if it directly precedes it, where both together are at most ``narrow`` wide, or where at most ``zero_share``
    of the common blocks are zeros; these are stored for the sake of longer loops (Ashcraft and Grimes 1989, relaxed
    supernodes).
    """
    count = len(parents)
    firsts, stored = np.empty(count + 1, np.int64), np.empty(count, np.int64)
    runs = 0
    for column in range(count):
        firsts[runs], stored[runs] = column, blocks[column]
        runs += 1
        firsts[runs] = column + 1
        while runs > 1 and 0 <= parents[firsts[runs - 1] - 1] <= column:
            first = firsts[runs - 2]
            width = column + 1 - first
            room = width * (width - 1) // 2 + width * blocks[column]
            used = stored[runs - 2] + stored[runs - 1]
            if width > narrow and room - used > zero_share * room:
                break
            runs -= 1
            stored[runs - 1] = used
            firsts[runs] = column + 1
    run_of, above = stored, np.empty(runs, np.int64)
    for run in range(runs - 1, -1, -1):
        for column in range(firsts[run], firsts[run + 1]):
            run_of[column] = run
        parent = parents[firsts[run + 1] - 1]
        above[run] = run_of[parent] if parent >= 0 else -1
    return firsts[: runs + 1].copy(), above


@kernel
def fill_in(starts: Int, neighbours: Int, order: Int, places: Int, firsts: Int, parents: Int) -> tuple[Int, Int, Int]:
    """The rows that each run has in L below its own columns, sorted: ``rows[row_starts[s] : row_starts[s + 1]]``.

    It also returns the block row of each of them in the front of the parent, where the parent's columns come first.
    """
    count, runs = len(order), len(parents)
    run_of, seen_by = np.empty(count, np.int64), np.empty(runs, np.int64)
    for run in range(runs):
        for column in range(firsts[run], firsts[run + 1]):
            run_of[column] = run
    row_starts, filled = np.zeros(runs + 1, np.int64), np.zeros(runs, np.int64)
    rows = np.empty(0, np.int64)
    for storing in range(2):
        seen_by.fill(-1)
        for row in range(count):
            vertex, own = order[row], run_of[row]
            for p in range(starts[vertex], starts[vertex + 1]):
                column = places[neighbours[p]]
                if column > row:
                    continue
                run = run_of[column]
                while run != own and seen_by[run] != row:
                    seen_by[run] = row
                    if storing:
                        rows[filled[run]] = row
                    filled[run] += 1
                    run = parents[run]
        if not storing:
            for run in range(runs):
                row_starts[run + 1] = row_starts[run] + filled[run]
                filled[run] = row_starts[run]
            rows = np.empty(row_starts[runs], np.int64)

    in_parent = np.empty(len(rows), np.int64)
    for run in range(runs):
        parent = parents[run]
        if parent < 0:
            continue
        width = firsts[parent + 1] - firsts[parent]
        q = row_starts[parent]
        for p in range(row_starts[run], row_starts[run + 1]):
            if rows[p] < firsts[parent + 1]:
                in_parent[p] = rows[p] - firsts[parent]
            else:
                while rows[q] != rows[p]:
                    q += 1
                in_parent[p] = width + q - row_starts[parent]
    return row_starts, rows, in_parent


@kernel
def block_layout(ends: Int, places: Int, firsts: Int, row_starts: Int, rows: Int) -> tuple[Int, Int, Int]:
    """Where H's blocks below the diagonal are stored: column after column, each with its block row in the run's front.

    Returns the block of each edge (-1 where an end is fixed), shape (m,), where each column's blocks begin, shape
    (count + 1,), and the block rows.
    """
    count = len(places)
    starts = np.zeros(count + 2, np.int64)
    for k in range(len(ends)):
        i, j = ends[k, 0], ends[k, 1]
        if i >= 0 and j >= 0:
            starts[min(places[i], places[j]) + 2] += 1
    for column in range(count):
        starts[column + 2] += starts[column + 1]
    edge_of, block_of_edge = np.empty(starts[count + 1], np.int64), np.empty(len(ends), np.int64)
    for k in range(len(ends)):
        i, j = ends[k, 0], ends[k, 1]
        block_of_edge[k] = -1
        if i >= 0 and j >= 0:
            column = min(places[i], places[j])
            edge_of[starts[column + 1]] = k
            starts[column + 1] += 1

    block_rows = np.empty(len(edge_of), np.int64)
    front_row, block_of_row, free = np.empty(count, np.int64), np.empty(count, np.int64), 0
    block_of_row.fill(-1)
    for run in range(len(row_starts) - 1):
        first, end = firsts[run], firsts[run + 1]
        for row in range(first, end):
            front_row[row] = row - first
        for p in range(row_starts[run], row_starts[run + 1]):
            front_row[rows[p]] = end - first + p - row_starts[run]
        for column in range(first, end):
            own, begin, last = free, starts[column], starts[column + 1]
            starts[column] = free
            for p in range(begin, last):
                k = edge_of[p]
                row = max(places[ends[k, 0]], places[ends[k, 1]])
                if block_of_row[row] < own:
                    block_of_row[row] = free
                    block_rows[free] = front_row[row]
                    free += 1
                block_of_edge[k] = block_of_row[row]
    starts[count] = free
    return block_of_edge, starts[: count + 1], block_rows[:free].copy()


@kernel
def storage(firsts: Int, parents: Int, row_starts: Int, subtrees: Int) -> tuple[Int, Int, Int, Int]:
    """Where the panel of each run begins in L, and its update in the workspace, each with the end: shape (runs + 1,).

    It also returns the tree from the root down: the first child of each run, and its next sibling; -1 where there is
    none.

    An update is needed until the parent of its run has read it. The updates of runs at an even depth of the tree are on
    one stack, those at an odd depth on another, so that a run can write its update while it reads its children's,
    without moving either. Each of the ``subtrees``, ranges of runs, has its own pair of stacks.
    """
    runs = len(parents)
    panel_starts, update_starts = np.zeros(runs + 1, np.int64), np.empty(runs + 1, np.int64)
    stack, of_children = np.zeros(runs, np.int64), np.zeros(runs, np.int64)
    for k in range(len(subtrees)):
        stack[subtrees[k, 0] : subtrees[k, 1]] = 2 * k + 2
    first_child, next_child = np.empty(runs, np.int64), np.empty(runs, np.int64)
    for run in range(runs - 1, -1, -1):
        first_child[run] = next_child[run] = -1
        parent = parents[run]
        if parent >= 0:
            stack[run] += 1 - stack[parent] % 2
            next_child[run] = first_child[parent]
            first_child[parent] = run
    tops, highest = np.zeros(2 * len(subtrees) + 2, np.int64), np.zeros(2 * len(subtrees) + 3, np.int64)
    for run in range(runs):
        width, below = firsts[run + 1] - firsts[run], row_starts[run + 1] - row_starts[run]
        panel_starts[run + 1] = panel_starts[run] + 9 * width * (width + below)
        mine = stack[run]
        tops[mine ^ 1] -= of_children[run]
        update_starts[run] = tops[mine]
        size = 9 * below * below
        if parents[run] >= 0 and stack[parents[run]] // 2 == mine // 2:
            of_children[parents[run]] += size
        tops[mine] += size
        highest[mine + 1] = max(highest[mine + 1], tops[mine])
    begins = np.cumsum(highest)
    for run in range(runs):
        update_starts[run] += begins[stack[run]]
    update_starts[runs] = begins[-1]
    return panel_starts, update_starts, first_child, next_child
