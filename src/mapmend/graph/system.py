"""The normal equations of a pose graph: analysed once for a pattern, filled and factorized as often as needed.

The unknowns are the motions ``d`` of the nodes that are not fixed, each in the node's own frame (``X <- X * d``), so
that the inverse of H holds covariances in the sense of ``geometry.se2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.checks import check_connections, same_pattern
from mapmend.graph.pose_graph import Float, Int, PoseGraph

# Below this share of its diagonal entry, a pivot is what rounding left of a subtraction.
SMALLEST_PIVOT = 1e-13
# One layout for all callers: a read-only or a strided array would compile the kernel once more.
KERNEL_ARRAYS: tuple[Literal["C"], Literal["W"]] = ("C", "W")


@dataclass(frozen=True)
class Linearization:
    """``chi2`` at some poses, the upper triangle of H there (CSC values) and the gradient, shape (size,)."""

    chi2: float
    values: Float
    gradient: Float


@dataclass(frozen=True)
class Factorization:
    """``H[order][:, order] = (I + L) D (I + L)^T``; L by columns, the rows of each rising.

    ``unknowns``: shape (n,), which three rows of H a node has, -1 where it is fixed.
    """

    starts: Int
    rows: Int
    lower: Float
    diagonal: Float
    order: Int
    unknowns: Int

    def solve(self, right_sides: Float) -> Float:
        """``H^-1 b`` for ``b`` of shape (size,) or (size, k)."""
        from mapmend.graph import _kernels

        solution = np.zeros(right_sides.shape)
        if len(self.order):
            ordered = np.array(right_sides[self.order].reshape(len(self.order), -1).T, dtype=np.float64, order="C")
            _kernels.solve(self.starts, self.rows, self.lower, self.diagonal, ordered)
            solution[self.order] = ordered.T.reshape(right_sides.shape)
        return solution


class System:
    """The pattern of a graph's normal equations, and the factorization that follows the pattern.

    Made from the nodes, edges and fixed nodes alone: poses, measurements and information may change between solves.
    Raises ``MapmendError`` where the pattern leaves a node loose.
    """

    def __init__(self, graph: PoseGraph) -> None:
        check_connections(graph)
        self.edges = np.array(graph.edges, dtype=np.int64, order="C")
        self.fixed = tuple(graph.fixed)
        self.ids = graph.ids
        free = np.ones(len(graph), dtype=np.bool_)
        free[list(self.fixed)] = False
        self.nodes = np.flatnonzero(free)
        self.unknowns = np.full(len(graph), -1, dtype=np.int64)
        self.unknowns[self.nodes] = np.arange(len(self.nodes))
        self.size = 3 * len(self.nodes)
        self._lay_out_blocks()
        self._solver: Any = None

    def _lay_out_blocks(self) -> None:
        """The columns of the upper triangle: the blocks above the diagonal by row, then the diagonal's own."""
        count = len(self.nodes)
        ends = self.unknowns[self.edges]
        inner = (ends >= 0).all(axis=1)
        upper, right = ends[inner].min(axis=1), ends[inner].max(axis=1)
        keys, block_of_edge = np.unique(right * count + upper, return_inverse=True)
        block_rows, block_columns = keys % max(count, 1), keys // max(count, 1)
        blocks_above = np.bincount(block_columns, minlength=count)
        first_block = np.cumsum(blocks_above) - blocks_above
        ranks = np.arange(len(keys)) - first_block[block_columns]
        self.block_ranks = np.zeros(len(self.edges), dtype=np.int64)
        self.block_ranks[inner] = ranks[block_of_edge]

        lengths = 3 * blocks_above[:, None] + np.array([1, 2, 3])
        self.column_starts = np.concatenate(([0], np.cumsum(lengths))).astype(np.int64)
        self.row_indices = np.empty(self.column_starts[-1], dtype=np.int64)
        for column in range(3):
            heads = self.column_starts[column:-1:3]
            for row in range(3):
                self.row_indices[heads[block_columns] + 3 * ranks + row] = 3 * block_rows + row
            for row in range(column + 1):
                self.row_indices[heads + 3 * blocks_above + row] = 3 * np.arange(count) + row

    def matches(self, graph: PoseGraph) -> bool:
        """Whether this analysis holds for the graph."""
        return same_pattern(graph, self.edges, self.fixed, len(self.unknowns))

    def linearize(self, poses: Float, measurements: Float, information: Float) -> Linearization:
        """The normal equations at ``poses``, shape (n, 3); a robust weight is a factor on the (m, 3, 3) information."""
        from mapmend.graph import _kernels

        chi2, values, gradient = _kernels.linearize(
            np.require(poses, np.float64, KERNEL_ARRAYS),
            self.edges,
            np.require(measurements, np.float64, KERNEL_ARRAYS),
            np.require(information, np.float64, KERNEL_ARRAYS),
            self.unknowns,
            self.column_starts,
            self.block_ranks,
        )
        return Linearization(chi2, values, gradient)

    def move(self, poses: Float, step: Float) -> Float:
        """``X * d`` for every node that is not fixed; ``step`` has shape (size,)."""
        moved = poses.copy()
        moved[self.nodes] = se2.compose(poses[self.nodes], step.reshape(-1, 3))
        return moved

    def factorize(self, values: Float, damping: float = 0.0) -> Factorization:
        """L and D of ``H + damping * diag(H)``; ordered and analysed the first time, refilled afterwards.

        Raises ``MapmendError`` where a pivot is not positive, or so small that only rounding is left of it.
        """
        import qdldl
        from scipy.sparse import csc_matrix

        if not self.size:
            empty = np.zeros(0, dtype=np.int64)
            return Factorization(np.zeros(1, dtype=np.int64), empty, np.zeros(0), np.zeros(0), empty, self.unknowns)
        ends = self.column_starts[1:] - 1
        if damping:
            values = values.copy()
            values[ends] *= 1.0 + damping
        matrix = csc_matrix((values, self.row_indices, self.column_starts), shape=(self.size, self.size))
        try:
            if self._solver is None:
                self._solver = qdldl.Solver(matrix, upper=True)
            else:
                self._solver.update(matrix, upper=True)
        except RuntimeError as error:  # qdldl met a pivot of exactly zero
            self._solver = None
            raise MapmendError("the graph's equations are singular: some edges carry no weight") from error
        L, D, order = self._solver.factors()
        weak = ~(SMALLEST_PIVOT * values[ends][order] < D)
        if weak.any():
            node = self.ids[self.nodes[order[np.argmax(weak)] // 3]]
            raise MapmendError(f"the graph's equations are singular to rounding: nothing holds node {node} in place")
        return Factorization(L.indptr, L.indices, L.data, D, order, self.unknowns)
