"""What the front end has built so far: nodes, edges, and where every scan of the log hangs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.scan import ScanLog

Float = NDArray[np.float64]

# Nodes of the shortest stretches; of the next, twice as many, and so on.
SHORTEST_STRETCH = 8
# A stretch less sure than this of its parts' covariance, by determinants, has something to add.
WORTH_ADDING = 0.5
# A step that was changed by more than this share of itself was tracked wrong, and so were the scans along it.
WRONG_SHARE = 0.5
# Information must be positive also along a bare corridor, where the chain of edges lacks none.
LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class LoopEdge:
    """A verified match of node ``node`` with the local grid of the key-node whose node is ``anchor``."""

    anchor: int
    node: int
    T_anchor_node: Float
    information: Float


@dataclass(frozen=True)
class StretchEdge:
    """What the odometry edges from node ``first`` to ``last`` measured, with the ``information`` that they lack."""

    first: int
    last: int
    T_first_last: Float
    information: Float


class GraphState:
    """Nodes in the order of the trajectory, odometry edges between neighbours, loop edges, and the scans on them.

    ``node_pose`` (n, 3), ``node_scan`` (n,), ``node_path_m`` (n,) trajectory length up to the node; row j of
    ``odometry_edge`` / ``odometry_covariance`` belongs to the edge from node j - 1 to j. ``scan_node`` names the node
    that a scan hangs on by ``T_node_scan``.

    The errors of neighbouring odometry edges cancel: that of the match of the node between them enters both, with
    opposite signs. Along a stretch of trajectory only the errors of its two ends are left, and ``odometry_drift``
    (n, 3, 3), the part of each edge's covariance that adds up. A chain of independent edges counts every node's error
    twice instead, and covariances over 20 m come out wider by ten. *Stretch edges* tell the graph: they join nodes 8,
    16, 32 ... apart, measure what the edges between them measure, and have the information that these lack.
    """

    def __init__(self, log: ScanLog) -> None:
        n = len(log)
        self.log = log
        self.count = 0
        self.node_pose = np.zeros((n, 3))
        self.node_scan = np.zeros(n, dtype=np.int64)
        self.node_path_m = np.zeros(n)
        self.odometry_edge = np.zeros((n, 3))
        self.odometry_covariance = np.zeros((n, 3, 3))
        self.odometry_drift = np.zeros((n, 3, 3))
        self.tracked_step = np.zeros((n, 3))  # the odometry edges as the front end found them, scans in between
        self._laid = np.zeros((n, 3))  # the odometry edges one after the other
        self.scan_node = np.zeros(n, dtype=np.int64)
        self.T_node_scan = np.zeros((n, 3))
        self.stretches: list[StretchEdge] = []
        self.loops: list[LoopEdge] = []

    @property
    def last(self) -> int:
        """The newest node."""
        return self.count - 1

    def add_node(self, scan: int, pose: Float, covariance: Float, drift: Float) -> int:
        """Appends a node at ``pose`` (3,), held to the one before it with ``covariance`` (3, 3), of which ``drift``."""
        j = self.count
        self.node_pose[j] = pose
        self.node_scan[j] = scan
        self.count = j + 1
        if j:
            edge = se2.between(self.node_pose[j - 1], pose)
            self.odometry_edge[j] = self.tracked_step[j] = edge
            self.odometry_covariance[j] = covariance
            self.odometry_drift[j] = drift
            self._laid[j] = se2.compose(self._laid[j - 1], edge)
            self.node_path_m[j] = self.node_path_m[j - 1] + float(np.hypot(edge[0], edge[1]))
            self._add_stretches(j)
        self.hang_scan(scan, j, pose)
        return j

    def hang_scan(self, scan: int, node: int, pose: Float) -> Float:
        """Notes that ``scan`` was found at ``pose`` (3,), to move along with ``node``; returns its place on it."""
        self.scan_node[scan] = node
        step = se2.between(self.node_pose[node], pose)
        self.T_node_scan[scan] = step
        return step

    def covariance_between(self, first: int, last: int) -> Float:
        """The covariance of ``T_first_last`` along the odometry edges, in the frame of ``last``: IGO eq. (6).

        The drift of every edge, and the rest of the first and the last, half of which is each end's own.
        """
        if last <= first:
            return np.zeros((3, 3))
        rows = np.arange(first + 1, last + 1)
        own = self.odometry_covariance[rows[[0, -1]]] - self.odometry_drift[rows[[0, -1]]]
        carry = self._carry(rows, last)
        drift = _carried(carry, self.odometry_drift[rows]).sum(axis=0)
        return np.asarray(drift + 0.5 * (_carried(carry[0], own[0]) + own[1]))

    def _carry(self, nodes: NDArray[np.int64], last: int) -> Float:
        """The matrices that carry a motion of each of the nodes into the frame of ``last``."""
        return se2.adjoint(se2.between(self.node_pose[last], self.node_pose[nodes]))

    def _add_stretches(self, last: int) -> None:
        """The stretch edges that end at the newest node."""
        span = SHORTEST_STRETCH
        while last % span == 0:
            first = last - span
            covariance = self.covariance_between(first, last)
            parts = self._covariance_of_parts(first, last)
            if np.linalg.det(covariance) < WORTH_ADDING * np.linalg.det(parts):
                lacking = se2.invert_symmetric(covariance) - (1.0 - LEAST_SHARE) * se2.invert_symmetric(parts)
                measured = se2.between(self._laid[first], self._laid[last])
                self.stretches.append(StretchEdge(first, last, measured, lacking))
            span *= 2

    def _covariance_of_parts(self, first: int, last: int) -> Float:
        """What a stretch's covariance is to a graph that knows its parts alone: its halves, or its odometry edges."""
        if last - first > SHORTEST_STRETCH:
            middle = (first + last) // 2
            carry = self._carry(np.array([middle]), last)[0]
            return _carried(carry, self.covariance_between(first, middle)) + self.covariance_between(middle, last)
        rows = np.arange(first + 1, last + 1)
        return np.asarray(_carried(self._carry(rows, last), self.odometry_covariance[rows]).sum(axis=0))

    def replace_odometry(self, edges: dict[int, tuple[Float, Float, Float]]) -> None:
        """New measurements (3,), covariances and drifts (3, 3) of odometry edges, by the node that each ends at.

        All that is derived from odometry edges is derived again: the trajectory's length and the stretch edges.
        """
        for j, (edge, covariance, drift) in edges.items():
            self.odometry_edge[j] = edge
            self.odometry_covariance[j], self.odometry_drift[j] = covariance, drift
        self.stretches = []
        for j in range(1, self.count):
            edge = self.odometry_edge[j]
            self._laid[j] = se2.compose(self._laid[j - 1], edge)
            self.node_path_m[j] = self.node_path_m[j - 1] + float(np.hypot(edge[0], edge[1]))
            self._add_stretches(j)

    def pose_graph(self, with_scans: bool = False) -> PoseGraph:
        """The graph of all nodes and edges: odometry, stretches, loops; the scans with it where asked for."""
        n, chain = self.count, np.arange(1, self.count)
        stretches, loops, rows = self.stretches, self.loops, self.node_scan[:n]
        joined = [(e.first, e.last) for e in stretches] + [(e.anchor, e.node) for e in loops]
        measured = [e.T_first_last for e in stretches] + [e.T_anchor_node for e in loops]
        information = [e.information for e in stretches] + [e.information for e in loops]
        own = np.linalg.inv(self.odometry_covariance[1:n])
        return PoseGraph(
            poses=self.node_pose[:n].copy(),
            ids=np.arange(n, dtype=np.int64),
            edges=np.concatenate(
                (np.stack((chain - 1, chain), axis=1), np.array(joined, dtype=np.int64).reshape(-1, 2))
            ),
            measurements=np.concatenate((self.odometry_edge[1:n], np.array(measured).reshape(-1, 3))),
            information=np.concatenate((0.5 * (own + own.swapaxes(1, 2)), np.array(information).reshape(-1, 3, 3))),
            is_loop=np.arange(len(chain) + len(joined)) >= len(chain) + len(stretches),
            scans=self.log.scans.select(rows) if with_scans else None,
            stamps_s=self.log.stamps_s[rows],
        )

    def scan_poses_at(self, node_poses: Float) -> Float:
        """``scan_poses`` with the nodes moved to ``node_poses``, shape (count, 3), for good."""
        self.node_pose[: self.count] = node_poses
        return self.scan_poses()

    def scan_poses(self) -> Float:
        """``T_map_robot`` of every scan of the log, shape (len(log), 3).

        A scan between two nodes follows both: it was found relative to the node before it, and what the optimizer
        changed of the step to the node behind it is shared out along the way. Where that is more than half of the step,
        the way was wrong too, and the scans are laid evenly in between, one after the other.
        """
        node = self.scan_node
        behind = se2.compose(self.node_pose[node], self.T_node_scan)
        after = np.minimum(node + 1, self.last)
        step = se2.compose(self.node_pose[node], self.tracked_step[after])
        change = se2.between(step, self.node_pose[after])
        length = np.hypot(self.tracked_step[after, 0], self.tracked_step[after, 1])
        turn = np.abs(self.tracked_step[after, 2])
        way = np.hypot(self.T_node_scan[:, 0], self.T_node_scan[:, 1]) + np.abs(self.T_node_scan[:, 2])
        share = np.clip(way / np.maximum(length + turn, 1e-9), 0.0, 1.0)
        share[after == node] = 0.0
        is_wrong = np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2]) > WRONG_SHARE * (length + turn)
        # The change is a small motion at the next node; carried back to the scan, it is scaled before it is applied.
        T_scan_next = se2.between(behind, step)
        carried = np.einsum("nij,nj->ni", se2.adjoint(T_scan_next), change)
        poses = se2.compose(behind, share[:, None] * carried)
        rows = np.flatnonzero(is_wrong & (after > node))
        poses[rows] = self._laid_evenly(rows)
        return poses

    def _laid_evenly(self, scans: NDArray[np.int64]) -> Float:
        """Poses of scans (m,) that divide the steps between their nodes in proportion to how many scans lie there."""
        node = self.scan_node[scans]
        begin, end = self.node_scan[node], self.node_scan[node + 1]
        step = se2.between(self.node_pose[node], self.node_pose[node + 1])
        return se2.compose(self.node_pose[node], ((scans - begin) / (end - begin))[:, None] * step)


def _carried(carry: Float, covariance: Float) -> Float:
    """``A S A^T``, shapes (..., 3, 3)."""
    return np.asarray(carry @ covariance @ np.swapaxes(carry, -1, -2))
