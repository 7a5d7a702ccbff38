"""How a pattern is eliminated: the order of the nodes, the fronts, and where each number of H and of L is stored.

It is computed from the edges alone, by nodes instead of unknowns, which is a third of the size in each direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmend.graph._kernel_types import Fronts
from mapmend.graph.pose_graph import Float, Int

# The first value: runs of at most this many nodes are merged without conditions. The second: wider runs are merged
# while at most this share of their blocks are zeros.
NARROW, ZERO_SHARE = 3, 0.1
# A factorization of fewer multiply-adds takes a millisecond and would end before a second thread has begun. The tree is
# cut at most this many times, into at most this many subtrees; a tree without branches cannot be cut.
WORTH_THREADS, MOST_SUBTREES, MOST_CUTS = 2e7, 64, 10_000


@dataclass(frozen=True)
class Elimination:
    """``order``: the vertices in the order of elimination, shape (count,); ``places``: the inverse permutation.

    ``block_of_edge``: shape (m,), which block below the diagonal of H an edge adds to, -1 where an end is fixed.
    ``subtrees``, ``rest``: shape (k, 2) each, the first run and the end. Subtrees share nothing with each other and can
    be factorized at the same time; the rest is factorized after all of them, in its order.
    """

    order: Int
    places: Int
    block_of_edge: Int
    fronts: Fronts
    subtrees: Int
    rest: Int

    @property
    def lower_size(self) -> int:
        """How many numbers L holds."""
        return int(self.fronts.panel_starts[-1])

    @property
    def work_size(self) -> int:
        """How many numbers the workspace for the updates holds."""
        return int(self.fronts.update_starts[-1])

    def diagonal_blocks(self) -> Int:
        """The indices of the 3 x 3 diagonal block of each place in the panels, shape (count, 3, 3)."""
        firsts, rows = self.fronts.firsts.view(np.int64), np.diff(self.fronts.row_starts.view(np.int64))
        widths = np.diff(firsts)
        run = np.repeat(np.arange(len(widths)), widths)
        column = 3 * (np.arange(len(run)) - firsts[run])
        heights = 3 * (widths + rows)[run]
        corners = self.fronts.panel_starts.view(np.int64)[run] + column * (heights + 1)
        three = np.arange(3)
        return np.asarray(corners[:, None, None] + three[:, None] + heights[:, None, None] * three)


def analyse(ends: Int, count: int, threads: int = 1) -> Elimination:
    """The elimination of ``count`` vertices that edges join, ``ends``: shape (m, 2), negative where an end is fixed.

    The tree is cut into subtrees for so many ``threads``; the factor is the same for any number.
    """
    from mapmend.graph import _ordering_kernels as ordering
    from mapmend.graph import _symbolic_kernels as symbolic

    starts, neighbours = ordering.adjacency(ends, count)
    order = ordering.minimum_degree(starts, neighbours)
    order, parents, blocks = ordering.postorder(order, *ordering.elimination_tree(starts, neighbours, order))
    places = np.empty(count, dtype=np.int64)
    places[order] = np.arange(count)
    firsts, run_parents = symbolic.supernodes(parents, blocks, NARROW, ZERO_SHARE)
    row_starts, rows, in_parent = symbolic.fill_in(starts, neighbours, order, places, firsts, run_parents)
    block_of_edge, block_starts, block_rows = symbolic.block_layout(ends, places, firsts, row_starts, rows)
    subtrees, rest = cut(run_parents, multiply_adds(firsts, row_starts), threads)
    panel_starts, update_starts, first_child, next_child = symbolic.storage(firsts, run_parents, row_starts, subtrees)
    tree = (firsts, first_child, next_child)
    numbers = (row_starts, rows, in_parent, panel_starts, update_starts, block_starts, block_rows)
    fronts = Fronts._make(array.view(np.uint64) for array in (*tree, *numbers))
    return Elimination(order, places, block_of_edge, fronts, subtrees, rest)


def multiply_adds(firsts: Int, row_starts: Int) -> Float:
    """The number of multiply-adds of each run's elimination, shape (runs,)."""
    own, below = (3.0 * np.diff(starts) for starts in (firsts, row_starts))
    return np.asarray(((own + below) ** 3 - below**3) / 6.0)


def cut(parents: Int, work: Float, threads: int) -> tuple[Int, Int]:
    """The subtrees for parallel work, the most expensive first, and the rest; ranges of runs, shape (k, 2) each.

    ``parents``, ``work``: of each run, in postorder, so that a subtree is a range. The most expensive subtree is cut at
    its root again and again; the cut with which this many threads would finish first is taken.
    """
    runs, whole = len(parents), float(work.sum())
    if threads < 2 or whole < WORTH_THREADS:
        return np.zeros((0, 2), np.int64), np.array([[0, runs]])
    of_subtree, first = work.tolist(), list(range(runs))
    for run, parent in enumerate(parents.tolist()):
        if parent >= 0:
            of_subtree[parent] += of_subtree[run]
            first[parent] = min(first[parent], first[run])
    children = np.argsort(parents, kind="stable")
    child_starts = np.searchsorted(parents[children], np.arange(-1, runs + 1))
    roots, best, least = children[: child_starts[1]].tolist(), list[int](), whole
    for _ in range(MOST_CUTS):
        roots.sort(key=lambda root: -of_subtree[root])
        together = sum(of_subtree[root] for root in roots)
        if not 0 < len(roots) <= MOST_SUBTREES or whole - together >= least:
            break
        longest = whole - together + max(of_subtree[roots[0]], together / threads)
        if longest < least:
            best, least = roots.copy(), longest
        roots[:1] = children[child_starts[roots[0] + 1] : child_starts[roots[0] + 2]].tolist()
    subtrees = np.array([(first[root], root + 1) for root in best], np.int64).reshape(-1, 2)
    between = np.concatenate(([0], subtrees[np.argsort(subtrees[:, 0])].ravel(), [runs])).reshape(-1, 2)
    return subtrees, between[between[:, 0] < between[:, 1]]
