"""Groups of arrays that the kernels of the back end take as one argument. They are made without Numba."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Unsigned = NDArray[np.uint64]


class Fronts(NamedTuple):
    """The runs of places that are eliminated together; unsigned whole numbers, -1 turned into the largest.

    ``firsts``: the first place of each run, and the end. ``first_child``, ``next_child``: the tree of the runs.
    The block rows below run s are the places ``rows[row_starts[s] : row_starts[s + 1]]``, rising; in the front of the
    parent they are the block rows ``in_parent``. ``panel_starts``, ``update_starts``: where the numbers of each
    begin in L and in the workspace, and the end. H holds the diagonal blocks by place, then the blocks below them:
    column by column from ``block_starts``, at the block rows ``block_rows`` of the column's front. A block is stored by
    columns.
    """

    firsts: Unsigned
    first_child: Unsigned
    next_child: Unsigned
    row_starts: Unsigned
    rows: Unsigned
    in_parent: Unsigned
    panel_starts: Unsigned
    update_starts: Unsigned
    block_starts: Unsigned
    block_rows: Unsigned
