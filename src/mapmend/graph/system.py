"""The normal equations of a pose graph: analysed once for a pattern, filled and factorized as often as needed.

The unknowns are the motions ``d`` of the nodes that are not fixed, each in the node's own frame (``X <- X * d``), so
that the inverse of H holds covariances in the sense of ``geometry.se2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from mapmend.errors import MapmendError
from mapmend.graph.checks import check_connections, same_pattern
from mapmend.graph.elimination import Elimination, analyse
from mapmend.graph.pose_graph import Float, Int, PoseGraph
from mapmend.parallel import map_in_order

# Below this share of its diagonal entry, a pivot is only the rounding error of a subtraction.
SMALLEST_PIVOT = 1e-13
# One memory layout for all callers: Numba would compile the kernel again for a read-only or a strided array.
KERNEL_ARRAYS: tuple[Literal["C"], Literal["W"]] = ("C", "W")


@dataclass(frozen=True)
class Linearization:
    """``chi2`` at some poses, the blocks of H there (``_kernels.linearize``) and the gradient, shape (size,)."""

    chi2: float
    values: Float
    gradient: Float


@dataclass(frozen=True)
class Factorization:
    """``H = L L^T``, the nodes in the order of the elimination; ``lower``: the numbers of L (``Fronts``).

    ``unknowns``: shape (n,), the index of a node's three rows of H, -1 where it is fixed.
    """

    elimination: Elimination
    lower: Float
    unknowns: Int

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return 3 * len(self.elimination.order)

    def solve(self, right_sides: Float) -> Float:
        """``H^-1 b`` for ``b`` of shape (size,) or (size, k)."""
        from mapmend.graph import _factor_kernels

        solutions = np.array(right_sides.reshape(len(right_sides), -1).T, dtype=np.float64, order="C")
        _factor_kernels.solve(self.elimination.fronts, self.elimination.order, self.lower, solutions)
        return solutions.T.reshape(right_sides.shape)


class System:
    """The pattern of a graph's normal equations, and the elimination that follows the pattern.

    Made from the nodes, edges and fixed nodes alone: poses, measurements and information may change between solves.
    Raises ``MapmendError`` if a node is not connected to a fixed one. ``threads`` factorize large systems, subtrees in
    parallel; the numbers are the same for any number of threads.
    """

    def __init__(self, graph: PoseGraph, threads: int = 1) -> None:
        check_connections(graph)
        self.edges = np.array(graph.edges, dtype=np.int64, order="C")
        self.fixed = tuple(graph.fixed)
        self.ids = graph.ids
        self.threads = threads
        free = np.ones(len(graph), dtype=np.bool_)
        free[list(self.fixed)] = False
        self.nodes = np.flatnonzero(free)
        self.unknowns = np.full(len(graph), -1, dtype=np.int64)
        self.unknowns[self.nodes] = np.arange(len(self.nodes))
        self.size = 3 * len(self.nodes)

    @cached_property
    def elimination(self) -> Elimination:
        """The order of elimination and what follows from it, computed when first needed."""
        return analyse(self.unknowns[self.edges], len(self.nodes), self.threads)

    @cached_property
    def places(self) -> Int:
        """The place of each node in the elimination, shape (n,), -1 where it is fixed."""
        places = np.full(len(self.unknowns), -1, dtype=np.int64)
        places[self.nodes] = self.elimination.places
        return places

    @cached_property
    def _work(self) -> Float:
        """Memory for the updates, the same for every factorization."""
        return np.empty(self.elimination.work_size)

    @cached_property
    def _lower(self) -> Float:
        """Memory for a factor that is used once."""
        return np.empty(self.elimination.lower_size)

    def matches(self, graph: PoseGraph) -> bool:
        """Whether this analysis holds for the graph."""
        return same_pattern(graph, self.edges, self.fixed, len(self.unknowns))

    def linearize(
        self, poses: Float, measurements: Float, information: Float, into: Linearization | None = None
    ) -> Linearization:
        """The normal equations at ``poses``, shape (n, 3); a robust weight is a factor on the (m, 3, 3) information.

        ``into``: normal equations that are no longer needed; their memory is reused.
        """
        from mapmend.graph import _kernels

        count = len(self.nodes)
        values = into.values if into else np.empty(9 * (count + len(self.elimination.fronts.block_rows)))
        chi2, gradient = _kernels.linearize(
            np.require(poses, np.float64, KERNEL_ARRAYS),
            self.edges,
            np.require(measurements, np.float64, KERNEL_ARRAYS),
            np.require(information, np.float64, KERNEL_ARRAYS),
            self.places,
            self.elimination.block_of_edge,
            count,
            values,
        )
        return Linearization(chi2, values, gradient)

    def move(self, poses: Float, step: Float) -> Float:
        """``X * d`` for every node that is not fixed; ``step`` has shape (size,)."""
        from mapmend.graph import _kernels

        poses = np.require(poses, np.float64, KERNEL_ARRAYS)
        return _kernels.move(poses, self.nodes, np.require(step, np.float64, KERNEL_ARRAYS))

    def factorize(self, values: Float, damping: float = 0.0) -> Factorization:
        """L of ``H + damping * diag(H)``; not thread-safe, because it uses memory of the system.

        Raises ``MapmendError`` if a pivot is not positive, or so small that it is only rounding error.
        """
        return self._factorize(values, damping, np.empty(self.elimination.lower_size))

    def solve(self, values: Float, right_side: Float, damping: float = 0.0) -> Float:
        """The result of ``factorize(values, damping).solve(right_side)``, in memory that the next call reuses.

        New memory takes more time than the numbers that are written into it: the system clears it page by page.
        """
        return self._factorize(values, damping, self._lower).solve(right_side)

    def solve_again(self, right_side: Float) -> Float:
        """``H^-1 b`` by the factor that the last ``solve`` made."""
        return Factorization(self.elimination, self._lower, self.unknowns).solve(right_side)

    def _factorize(self, values: Float, damping: float, lower: Float) -> Factorization:
        from mapmend.graph import _factor_kernels

        elimination, room = self.elimination, self._work

        def work(runs: list[int]) -> int:
            fronts, scale = elimination.fronts, 1.0 + damping
            return int(_factor_kernels.factorize(values, scale, SMALLEST_PIVOT, fronts, lower, room, *runs))

        places = map_in_order(work, elimination.subtrees.tolist(), self.threads)
        weak = min((place for place in places if place >= 0), default=-1)
        if weak < 0:
            weak = next((place for place in map(work, elimination.rest.tolist()) if place >= 0), -1)
        if weak >= 0:
            node = self.ids[self.nodes[self.elimination.order[weak]]]
            raise MapmendError(f"the graph's equations are singular to rounding: nothing holds node {node} in place")
        return Factorization(self.elimination, lower, self.unknowns)
