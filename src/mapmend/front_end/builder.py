"""The front end: from a log to a pose graph with scans, scan by scan. IGO section III."""

from __future__ import annotations

import math

import numpy as np

from mapmend.config import Config
from mapmend.front_end.edge_covariance import edge_covariance
from mapmend.front_end.global_grid import GlobalGrid
from mapmend.front_end.key_nodes import KeyNodes
from mapmend.front_end.loop_closing import LoopSearch, Solved
from mapmend.front_end.motion import odometry_covariance
from mapmend.front_end.points import ScanPoints
from mapmend.front_end.state import Float, GraphState, LoopEdge
from mapmend.front_end.tracking import Tracker
from mapmend.geometry import se2
from mapmend.graph.optimizer import optimize
from mapmend.matching.gauss_newton import Match, SurfaceMatcher
from mapmend.parallel import Progress, no_progress
from mapmend.scan import ScanLog

# An optimization that moves no node by more leaves the global grid as it is.
STILL_M = 0.02
STILL_RAD = 0.007
# A loop edge to a known key-node that disagrees by more calls for an optimization.
STRAIN_M = 0.06
STRAIN_RAD = 0.02


class FrontEnd:
    """Goes through a log once; `state` then holds nodes, edges and where every scan hangs."""

    def __init__(self, log: ScanLog, config: Config, progress: Progress = no_progress) -> None:
        self.log = log
        self.config = config
        self.state = GraphState(log)
        self._progress = progress
        self._motions = se2.between(log.odometry[:-1], log.odometry[1:])
        self.points = ScanPoints(log.scans, config.scan)
        self.matcher = SurfaceMatcher(config.match)
        self._tracker = Tracker(self.matcher, config)
        self.key_nodes = KeyNodes(self.state, self.points, config)
        self._global = GlobalGrid(self.state, self.key_nodes, config)
        self.loops = LoopSearch(self.state, self.key_nodes, self.points, self.matcher, config)
        self._inserted_at = np.full(3, np.inf)
        self._motion_since_node = np.zeros(3)
        self._covariance_at_node = np.zeros((3, 3))
        self._strained = False
        self._optimized_at_m = 0.0
        self.optimizations = 0
        self.searched = 0

    def run(self) -> GraphState:
        """Maps the whole log."""
        pose = np.zeros(3)
        total = len(self.log)
        for k in range(total):
            pose = self._take_scan(k, pose)
            if k % 100 == 99 or k == total - 1:
                self._progress("matching", k + 1, total)
        if self.config.loops.enabled and self.state.loops:
            self._optimize()
        return self.state

    def _take_scan(self, k: int, before: Float) -> Float:
        """Finds scan k, makes it a node where the robot went far enough, and closes the loops of that node."""
        if k == 0:
            self._open_node(0, before, None)
            return before
        motion = self._reported_motion(k)
        self._motion_since_node = se2.compose(self._motion_since_node, motion)
        tracked = self._tracker.track(self._global.grid, self.points.of(k), before, motion)
        self.searched += tracked.searched
        pose = tracked.match.pose
        if self._is_far(self.state.hang_scan(k, self.state.last, pose)):
            self._open_node(k, pose, tracked.match)
            self._close_loops()
            pose = self.state.node_pose[self.state.last].copy()
        self._insert(k, pose)
        return pose

    def _reported_motion(self, k: int) -> Float:
        """The odometry's step to scan k; without odometry, the step before it again."""
        if self.config.motion.use_odometry:
            return np.asarray(self._motions[k - 1])
        if k < 2:
            return np.zeros(3)
        state = self.state
        a, b = (se2.compose(state.node_pose[state.scan_node[row]], state.T_node_scan[row]) for row in (k - 2, k - 1))
        return se2.between(a, b)

    def _is_far(self, step: Float) -> bool:
        rows = self.config.key_nodes
        return bool(math.hypot(step[0], step[1]) >= rows.node_every_m or abs(step[2]) >= rows.node_every_rad)

    def _open_node(self, k: int, pose: Float, match: Match | None) -> None:
        """Adds the node and its odometry edge with the covariance of IGO (2)."""
        covariance, drift = (np.zeros((3, 3)),) * 2 if match is None else self._edge_covariance(match)
        node = self.state.add_node(k, pose, covariance, drift)
        self._motion_since_node = np.zeros(3)
        if self.key_nodes.add_node(node):
            self._global.refresh()
        if match is None:
            self._insert(k, pose)

    def _edge_covariance(self, match: Match) -> tuple[Float, Float]:
        """IGO (2) of the edge to the newest match, and its drift. Both ends were matched, each with its own noise."""
        odometry = odometry_covariance(self._motion_since_node, self.config.motion)
        observed = match.covariance()
        carry = se2.adjoint(se2.inverse(self._motion_since_node))
        both = observed + carry @ self._covariance_at_node @ carry.T
        self._covariance_at_node = observed
        return edge_covariance(both, odometry, match.score, self.config.match.min_score)

    def _insert(self, k: int, pose: Float) -> None:
        grid = self.config.grid
        step = pose - self._inserted_at
        near = math.hypot(step[0], step[1]) < grid.insert_every_m
        if near and abs(math.remainder(step[2], math.tau)) < grid.insert_every_rad:
            return
        self._global.grid.insert(self.points.of(k), self.points.laser_origin(k), pose)
        self._inserted_at = pose

    def _close_loops(self) -> None:
        """Searches loops of the newest node; optimizes when a new link closed or the graph is under strain."""
        if not self.config.loops.enabled:
            return
        known = self.key_nodes.known()
        closed = False
        for edge in self.loops.find():
            self.state.loops.append(edge)
            k = int(self.key_nodes.of_node[edge.anchor])
            closed |= k not in known
            self._strained |= self._is_strained(edge)
            self.key_nodes.link(k, self.key_nodes.last, 0.0)
        path = float(self.state.node_path_m[self.state.last])
        rested = path - self._optimized_at_m > self.config.key_nodes.trajectory_length_m
        if closed or (self._strained and rested):
            moved = self._optimize()
            if moved:
                self._global.rebuild()
            else:
                self._global.refresh()
            self._inserted_at = np.full(3, np.inf)

    def _is_strained(self, edge: LoopEdge) -> bool:
        poses = self.state.node_pose
        error = se2.between(edge.T_anchor_node, se2.between(poses[edge.anchor], poses[edge.node]))
        return bool(np.hypot(error[0], error[1]) > STRAIN_M or abs(error[2]) > STRAIN_RAD)

    def _optimize(self) -> bool:
        """Optimizes the graph of now; True where a node moved enough to build grids anew."""
        state = self.state
        result = optimize(state.pose_graph())
        step = se2.between(state.node_pose[: state.count], result.poses)
        state.node_pose[: state.count] = result.poses
        self.loops.solved = Solved.from_factor(result.factorization, result.poses)
        self._optimized_at_m = float(state.node_path_m[state.last])
        self._strained = False
        self.optimizations += 1
        return bool((np.hypot(step[:, 0], step[:, 1]) > STILL_M).any() or (np.abs(step[:, 2]) > STILL_RAD).any())
