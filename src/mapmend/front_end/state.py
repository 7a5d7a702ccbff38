"""What the front end has built so far: nodes, edges, and where every scan of the log hangs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.scan import ScanLog

Float = NDArray[np.float64]


@dataclass(frozen=True)
class LoopEdge:
    """A verified match of node ``node`` with the local grid of the key-node whose node is ``anchor``."""

    anchor: int
    node: int
    T_anchor_node: Float
    information: Float


class GraphState:
    """Nodes in the order of the trajectory, odometry edges between neighbours, loop edges, and the scans on them.

    ``node_pose`` (n, 3), ``node_scan`` (n,), ``node_path_m`` (n,) trajectory length up to the node; row j of
    ``odometry_edge`` / ``odometry_information`` belongs to the edge from node j - 1 to j. ``scan_node`` names the node
    that a scan hangs on by ``T_node_scan``.
    """

    def __init__(self, log: ScanLog) -> None:
        n = len(log)
        self.log = log
        self.count = 0
        self.node_pose = np.zeros((n, 3))
        self.node_scan = np.zeros(n, dtype=np.int64)
        self.node_path_m = np.zeros(n)
        self.odometry_edge = np.zeros((n, 3))
        self.odometry_information = np.zeros((n, 3, 3))
        self.scan_node = np.zeros(n, dtype=np.int64)
        self.T_node_scan = np.zeros((n, 3))
        self.loops: list[LoopEdge] = []

    @property
    def last(self) -> int:
        """The newest node."""
        return self.count - 1

    def add_node(self, scan: int, pose: Float, information: Float) -> int:
        """Appends a node at ``pose`` (3,), held to the one before it with ``information`` (3, 3)."""
        j = self.count
        self.node_pose[j] = pose
        self.node_scan[j] = scan
        if j:
            edge = se2.between(self.node_pose[j - 1], pose)
            self.odometry_edge[j] = edge
            self.odometry_information[j] = information
            self.node_path_m[j] = self.node_path_m[j - 1] + float(np.hypot(edge[0], edge[1]))
        self.count = j + 1
        self.hang_scan(scan, j, pose)
        return j

    def hang_scan(self, scan: int, node: int, pose: Float) -> Float:
        """Notes that ``scan`` was found at ``pose`` (3,), to move along with ``node``; returns its place on it."""
        self.scan_node[scan] = node
        step = se2.between(self.node_pose[node], pose)
        self.T_node_scan[scan] = step
        return step

    def chain_covariance(self, first: int, last: int) -> Float:
        """The covariance of ``T_first_last`` along the odometry edges, in the frame of ``last``: IGO eq. (6)."""
        if last <= first:
            return np.zeros((3, 3))
        rows = np.arange(first + 1, last + 1)
        carry = se2.adjoint(se2.between(self.node_pose[last], self.node_pose[rows]))
        covariance = np.linalg.inv(self.odometry_information[rows])
        return np.asarray((carry @ covariance @ np.swapaxes(carry, -1, -2)).sum(axis=0))

    def pose_graph(self, with_scans: bool = False) -> PoseGraph:
        """The graph of all nodes and edges, odometry first; the scans with it where asked for."""
        n, chain = self.count, np.arange(1, self.count)
        loops = np.array([(e.anchor, e.node) for e in self.loops], dtype=np.int64).reshape(-1, 2)
        rows = self.node_scan[:n]
        return PoseGraph(
            poses=self.node_pose[:n].copy(),
            ids=np.arange(n, dtype=np.int64),
            edges=np.concatenate((np.stack((chain - 1, chain), axis=1), loops)),
            measurements=np.concatenate(
                (self.odometry_edge[1:n], np.array([e.T_anchor_node for e in self.loops]).reshape(-1, 3))
            ),
            information=np.concatenate(
                (self.odometry_information[1:n], np.array([e.information for e in self.loops]).reshape(-1, 3, 3))
            ),
            is_loop=np.concatenate((np.zeros(len(chain), dtype=np.bool_), np.ones(len(loops), dtype=np.bool_))),
            scans=self.log.scans.select(rows) if with_scans else None,
            stamps_s=self.log.stamps_s[rows],
        )

    def scan_poses(self) -> Float:
        """``T_map_robot`` of every scan of the log, shape (len(log), 3).

        A scan between two nodes follows both: it was found relative to the node before it, and what the optimizer
        changed of the step to the node behind it is shared out along the way.
        """
        node = self.scan_node
        behind = se2.compose(self.node_pose[node], self.T_node_scan)
        after = np.minimum(node + 1, self.last)
        step = se2.compose(self.node_pose[node], self.odometry_edge[after])
        change = se2.between(step, self.node_pose[after])
        length = np.hypot(self.odometry_edge[after, 0], self.odometry_edge[after, 1])
        turn = np.abs(self.odometry_edge[after, 2])
        way = np.hypot(self.T_node_scan[:, 0], self.T_node_scan[:, 1]) + np.abs(self.T_node_scan[:, 2])
        share = np.clip(way / np.maximum(length + turn, 1e-9), 0.0, 1.0)
        share[after == node] = 0.0
        # The change is a small motion at the next node; carried back to the scan, it is scaled before it is applied.
        T_scan_next = se2.between(behind, step)
        carried = np.einsum("nij,nj->ni", se2.adjoint(T_scan_next), change)
        return se2.compose(behind, share[:, None] * carried)
