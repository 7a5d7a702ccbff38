"""Kernels that find the pairs of scans whose bounding boxes overlap."""

from __future__ import annotations

import numpy as np

from mapmend.kernel_cache import kernel


@kernel
def overlapping(i, boxes, cells, order, starts, width, found):
    """The number of scans after i whose boxes overlap its box; they are written into ``found``, sorted, if it is not
    empty.

    ``boxes``: (n, 4) low x, low y, high x, high y. Scans are sorted by the cell of their box's low corner: ``order``
    lists them by cell (row after row of ``width`` cells), ``starts`` gives the first of each cell. No box is wider than
    a cell, so that an overlapping box begins in one of the nine cells around.
    """
    count = 0
    height = (starts.shape[0] - 1) // width
    row, column = cells[i] // width, cells[i] % width
    for r in range(max(row - 1, 0), min(row + 2, height)):
        for c in range(max(column - 1, 0), min(column + 2, width)):
            for k in range(starts[r * width + c], starts[r * width + c + 1]):
                j = order[k]
                if j <= i:
                    continue
                apart = (
                    boxes[j, 0] > boxes[i, 2]
                    or boxes[i, 0] > boxes[j, 2]
                    or boxes[j, 1] > boxes[i, 3]
                    or boxes[i, 1] > boxes[j, 3]
                )
                if not apart:
                    if found.shape[0] > 0:
                        found[count] = j
                    count += 1
    if found.shape[0] > 0:
        found[:count].sort()
    return count


@kernel
def count_overlapping(boxes, cells, order, starts, width, counts):
    """How many scans after it overlap each scan, ``counts`` (n,)."""
    nowhere = np.empty(0, np.int64)
    for i in range(boxes.shape[0]):
        if not boxes[i, 0] > boxes[i, 2]:
            counts[i] = overlapping(i, boxes, cells, order, starts, width, nowhere)


@kernel
def list_overlapping(first, last, boxes, cells, grid, counts, pairs):
    """The overlapping pairs (i, j), i < j, of the scans from ``first`` to before ``last``, in order, into ``pairs``.

    ``grid`` = (order, starts, width) as in ``overlapping``.
    """
    order, starts, width = grid
    filled = 0
    for i in range(first, last):
        if counts[i] == 0:
            continue
        found = np.empty(counts[i], np.int64)
        overlapping(i, boxes, cells, order, starts, width, found)
        for k in range(counts[i]):
            pairs[filled, 0] = i
            pairs[filled, 1] = found[k]
            filled += 1
