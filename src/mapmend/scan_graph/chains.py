"""Chains of nodes: poses, odometry edges between neighbours, and covariances along them. IGO III-A."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.scan_graph.growing import GrowingArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Nodes of the shortest stretches; of the next, twice as many, and so on.
SHORTEST_STRETCH = 8
# A stretch edge is added where the covariance of the stretch is below this share of its parts', by determinants.
WORTH_ADDING = 0.5
# The information must be positive also along a bare corridor, where the chain of edges lacks none.
LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class StretchEdge:
    """What the odometry edges from node ``first`` to ``last`` measure together, with the ``information`` they lack."""

    first: int
    last: int
    T_first_last: Float
    information: Float


@dataclass(frozen=True)
class OdometryEdge:
    """A measurement (3,) of the motion between neighbours, its covariance and the part that adds up (3, 3)."""

    motion: Float
    covariance: Float
    drift: Float


class Chains:
    """Nodes in the order of the trajectory, and the odometry edges between neighbours.

    There is one chain for each drive, and a new one where a log is broken: no odometry edge leads to the first node of
    a chain. ``poses`` (n, 3): ``T_map_robot``; ``path_m`` (n,): length of the trajectory up to the node, over all
    chains; ``starts``: the first node of every chain. Row j of ``edges`` (n, 3), ``covariances`` and
    ``drifts`` (n, 3, 3) belongs to the edge from node j - 1 to j, and is zero where a chain begins.

    The errors of neighbouring odometry edges cancel: that of the match of the node between them enters both, with
    opposite signs. Along a stretch of trajectory only the errors of its two ends remain, and the drift, which is the
    part of each edge's covariance that adds up. A chain of independent edges counts every node's error twice instead,
    and covariances over 20 m are ten times too wide. *Stretch edges* correct this: they join nodes 8, 16, 32 ...
    apart, measure what the edges between them measure, and have the information that these lack. ``given_stretches``
    are those that came with a graph; they are kept.
    """

    def __init__(self) -> None:
        self._poses = GrowingArray((3,))
        self._path_m = GrowingArray()
        self._starts: list[int] = []
        self._edges = GrowingArray((3,))
        self._covariances = GrowingArray((3, 3))
        self._drifts = GrowingArray((3, 3))
        self._laid = GrowingArray((3,))  # the odometry edges of each chain laid end to end
        self.stretches: list[StretchEdge] = []
        self.given_stretches: list[StretchEdge] = []

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def last(self) -> int:
        """The newest node."""
        return len(self._poses) - 1

    @property
    def poses(self) -> Float:
        return self._poses.rows

    @property
    def path_m(self) -> Float:
        return self._path_m.rows

    @property
    def starts(self) -> list[int]:
        return self._starts

    @property
    def edges(self) -> Float:
        return self._edges.rows

    @property
    def covariances(self) -> Float:
        return self._covariances.rows

    @property
    def drifts(self) -> Float:
        return self._drifts.rows

    def begin(self, pose: Float) -> int:
        """Adds the first node of a new chain at ``pose`` (3,); returns its number."""
        nothing = np.zeros((3, 3))
        self._starts.append(len(self))
        self._append(pose, OdometryEdge(np.zeros(3), nothing, nothing), np.zeros(3))
        return self.last

    def add(self, pose: Float, edge: OdometryEdge) -> int:
        """Adds a node at ``pose`` (3,), with an edge from the node before it; returns its number."""
        self._append(pose, edge, se2.compose(self._laid.rows[-1], edge.motion))
        self._add_stretches(self.last)
        return self.last

    def _append(self, pose: Float, edge: OdometryEdge, laid: Float) -> None:
        way = float(np.hypot(edge.motion[0], edge.motion[1]))
        path = float(self.path_m[-1]) + way if len(self) else 0.0
        self._poses.append(pose)
        self._path_m.append(path)
        self._edges.append(edge.motion)
        self._covariances.append(edge.covariance)
        self._drifts.append(edge.drift)
        self._laid.append(laid)

    def move(self, poses: Float) -> None:
        """Moves all nodes to ``poses`` (n, 3). Edges and what is derived from them stay."""
        self._poses.rows[:] = poses

    def has_edge(self) -> NDArray[np.bool_]:
        """Which nodes an odometry edge ends at, shape (n,): all but the first of each chain."""
        has_edge = np.ones(len(self), dtype=np.bool_)
        has_edge[self._starts] = False
        return has_edge

    def chain_of(self, node: int) -> tuple[int, int]:
        """The chain that a node is in: its first node, and the node after its last."""
        chain = bisect_right(self._starts, node)
        return self._starts[chain - 1], self._starts[chain] if chain < len(self._starts) else len(self)

    def within(self, node: int, before_m: float, after_m: float) -> tuple[int, int]:
        """The nodes of the same chain from ``before_m`` of trajectory before ``node`` to ``after_m`` after it.

        The first of them, and the node after the last.
        """
        path, (begin, end) = self.path_m, self.chain_of(node)
        first = int(np.searchsorted(path[begin:end], path[node] - before_m))
        after = int(np.searchsorted(path[begin:end], path[node] + after_m, side="right"))
        return begin + first, begin + after

    def covariance_between(self, first: int, last: int, of_last: bool = True) -> Float:
        """The covariance of ``T_first_last`` along the odometry edges, in the frame of ``last``: IGO eq. (6).

        The drift of every edge, and the rest of the first and the last, half of which is that of each end. With
        ``of_last`` false, without the part of the last node's own match: the covariance of the map there, which many
        nodes drew. Raises MapmendError if a chain begins between the two, since then there is no odometry between them.
        """
        if last <= first:
            return np.zeros((3, 3))
        if first < self.chain_of(last)[0]:
            raise MapmendError(f"no chain of odometry edges leads from node {first} to node {last}")
        rows = np.arange(first + 1, last + 1)
        own = self.covariances[rows[[0, -1]]] - self.drifts[rows[[0, -1]]]
        carry = self._carry(rows, last)
        drift = _carried(carry, self.drifts[rows]).sum(axis=0)
        ends = _carried(carry[0], own[0]) + own[1] if of_last else _carried(carry[0], own[0])
        return np.asarray(drift + 0.5 * ends)

    def replace(self, edges: dict[int, OdometryEdge]) -> None:
        """New odometry edges, by the node that each ends at.

        The trajectory's length and the stretch edges are derived again. A stretch
        that came with the graph measures from now on what the edges between its nodes measure, if one of them is new.
        """
        for j, edge in edges.items():
            self.edges[j], self.covariances[j], self.drifts[j] = edge.motion, edge.covariance, edge.drift
        self.stretches = []
        for j in range(1, len(self)):
            edge = self.edges[j]
            self._path_m.rows[j] = self.path_m[j - 1] + float(np.hypot(edge[0], edge[1]))
            if self.chain_of(j)[0] != j:
                self._laid.rows[j] = se2.compose(self._laid.rows[j - 1], edge)
                self._add_stretches(j)
        self.given_stretches = [self._laid_anew(one, edges) for one in self.given_stretches]

    def _laid_anew(self, stretch: StretchEdge, edges: dict[int, OdometryEdge]) -> StretchEdge:
        if not any(stretch.first < j <= stretch.last for j in edges):
            return stretch
        return replace(stretch, T_first_last=self._measured(stretch.first, stretch.last))

    def _measured(self, first: int, last: int) -> Float:
        """``T_first_last`` (3,) as the odometry edges between two nodes measure it."""
        return se2.between(self._laid.rows[first], self._laid.rows[last])

    def _carry(self, nodes: Int, last: int) -> Float:
        """The matrices that carry a motion of each of the nodes into the frame of ``last``."""
        return se2.adjoint(se2.between(self.poses[last], self.poses[nodes]))

    def _add_stretches(self, last: int) -> None:
        """The stretch edges that end at a node, counted from the first node of its chain."""
        begin, _ = self.chain_of(last)
        span = SHORTEST_STRETCH
        while (last - begin) % span == 0:
            first = last - span
            covariance = self.covariance_between(first, last)
            parts = self._covariance_of_parts(first, last)
            if np.linalg.det(covariance) < WORTH_ADDING * np.linalg.det(parts):
                lacking = se2.invert_symmetric(covariance) - (1.0 - LEAST_SHARE) * se2.invert_symmetric(parts)
                self.stretches.append(StretchEdge(first, last, self._measured(first, last), lacking))
            span *= 2

    def _covariance_of_parts(self, first: int, last: int) -> Float:
        """The covariance of a stretch in a graph that has only its parts: its halves, or its odometry edges."""
        if last - first > SHORTEST_STRETCH:
            middle = (first + last) // 2
            carry = self._carry(np.array([middle]), last)[0]
            return _carried(carry, self.covariance_between(first, middle)) + self.covariance_between(middle, last)
        rows = np.arange(first + 1, last + 1)
        return np.asarray(_carried(self._carry(rows, last), self.covariances[rows]).sum(axis=0))


def _carried(carry: Float, covariance: Float) -> Float:
    """``A S A^T``, shapes (..., 3, 3)."""
    return np.asarray(carry @ covariance @ np.swapaxes(carry, -1, -2))
