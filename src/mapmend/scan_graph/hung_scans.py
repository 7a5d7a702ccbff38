"""Every scan of a log is attached to the node before it, and moves with the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.scan_graph.growing import GrowingArray

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# A step that was changed by more than this share of itself was tracked wrong, and so were the scans along it.
WRONG_SHARE = 0.5


class HungScans:
    """The log's data of each of its scans, and the pose at which each was found.

    A row for every scan: ``stamps_s`` (m,); ``odometry`` (m, 3), ``T_odometry_robot``; the ``node`` (m,) to which it is
    attached; ``T_node_scan`` (m, 3), the robot's pose at the scan, relative to that node. A row for every node:
    ``node_scan`` (n,), the scan that became the node; ``tracked_step`` (n, 3), the motion from the node before as it
    was found scan by scan; ``begins`` (n,), whether it is the first of a chain, and has no such motion.
    """

    def __init__(self) -> None:
        self._stamps_s = GrowingArray()
        self._odometry = GrowingArray((3,))
        self._node = GrowingArray(dtype=np.int64)
        self._T_node_scan = GrowingArray((3,))
        self._node_scan = GrowingArray(dtype=np.int64)
        self._tracked_step = GrowingArray((3,))
        self._begins = GrowingArray(dtype=np.bool_)

    def __len__(self) -> int:
        return len(self._node)

    @property
    def stamps_s(self) -> Float:
        return self._stamps_s.rows

    @property
    def odometry(self) -> Float:
        return self._odometry.rows

    @property
    def node(self) -> Int:
        return self._node.rows

    @property
    def T_node_scan(self) -> Float:
        return self._T_node_scan.rows

    @property
    def node_scan(self) -> Int:
        return self._node_scan.rows

    @property
    def tracked_step(self) -> Float:
        return self._tracked_step.rows

    @property
    def begins(self) -> NDArray[np.bool_]:
        return self._begins.rows

    def hang(self, stamp_s: float, odometry: Float, node: int, T_node_scan: Float) -> int:
        """Adds the next scan of the log; returns its number."""
        self._stamps_s.append(stamp_s)
        self._odometry.append(odometry)
        self._node.append(node)
        self._T_node_scan.append(T_node_scan)
        return len(self) - 1

    def note_node(self, scan: int, tracked_step: Float | None) -> None:
        """Records that a scan became the next node, ``tracked_step`` (3,) after the node before it.

        None if a chain begins with it: then the motion from the node before is not known.
        """
        self._node_scan.append(scan)
        self._tracked_step.append(np.zeros(3) if tracked_step is None else tracked_step)
        self._begins.append(tracked_step is None)

    def reported_motions(self) -> Float:
        """The odometry's motion from the node before, (n, 3); zero where a chain begins."""
        poses = self.odometry[self.node_scan]
        motions = np.concatenate((np.zeros((1, 3)), se2.between(poses[:-1], poses[1:])))
        motions[self.begins] = 0.0
        return motions

    def scan_poses(self, node_poses: Float) -> Float:
        """``T_map_robot`` of every scan of the log, shape (m, 3), with the nodes at ``node_poses`` (n, 3).

        A scan between two nodes follows both: it was found relative to the node before it, and it takes its share of
        the optimizer's change of the step to the next node. If this change is more than half of the step, the tracked
        poses in between were wrong too, and the scans are placed evenly between the two nodes.
        """
        node, tracked = self.node, self.tracked_step
        behind = se2.compose(node_poses[node], self.T_node_scan)
        after = np.minimum(node + 1, len(node_poses) - 1)
        after = np.where(self.begins[after], node, after)
        step = se2.compose(node_poses[node], tracked[after])
        change = se2.between(step, node_poses[after])
        length = np.hypot(tracked[after, 0], tracked[after, 1])
        turn = np.abs(tracked[after, 2])
        way = np.hypot(self.T_node_scan[:, 0], self.T_node_scan[:, 1]) + np.abs(self.T_node_scan[:, 2])
        share = np.clip(way / np.maximum(length + turn, 1e-9), 0.0, 1.0)
        share[after == node] = 0.0
        is_wrong = np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2]) > WRONG_SHARE * (length + turn)
        # The change is a small motion at the next node; carried back to the scan, it is scaled before it is applied.
        T_scan_next = se2.between(behind, step)
        carried = np.einsum("nij,nj->ni", se2.adjoint(T_scan_next), change)
        poses = se2.compose(behind, share[:, None] * carried)
        rows = np.flatnonzero(is_wrong & (after > node))
        poses[rows] = self._laid_evenly(rows, node_poses)
        return poses

    def _laid_evenly(self, scans: Int, node_poses: Float) -> Float:
        """Poses of scans (m,) that divide the steps between their nodes evenly."""
        node = self.node[scans]
        begin, end = self.node_scan[node], self.node_scan[node + 1]
        step = se2.between(node_poses[node], node_poses[node + 1])
        return se2.compose(node_poses[node], ((scans - begin) / (end - begin))[:, None] * step)
