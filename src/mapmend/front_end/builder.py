"""The front end: from a log to a graph of scans, scan by scan. IGO section III."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mapmend.config import Config
from mapmend.errors import MapmendError
from mapmend.front_end.global_grid import GlobalGrid
from mapmend.front_end.loop_closing import LoopSearch, Solved
from mapmend.front_end.tracking import Tracker
from mapmend.geometry import se2
from mapmend.graph.optimizer import optimize
from mapmend.matching.gauss_newton import Match
from mapmend.matching.uncertainty import Uncertainty
from mapmend.parallel import Progress, no_progress
from mapmend.scan import LaserGeometry, ScanLog, checked_ranges
from mapmend.scan_graph.chains import OdometryEdge
from mapmend.scan_graph.edge_covariance import edge_covariance
from mapmend.scan_graph.loop_edges import LoopEdge
from mapmend.scan_graph.motion import odometry_covariance
from mapmend.scan_graph.scan_graph import ScanGraph

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]

# If an optimization moves no node by more than this, the global grid stays as it is.
STILL_M = 0.02
STILL_RAD = 0.007


class FrontEnd:
    """Takes the scans of a drive one after the other; `graph` then holds nodes, edges and the place of every scan.

    ``geometries``: the lasers that scans come from; more may be added to ``graph.scans.geometries`` on the way.
    """

    def __init__(self, geometries: Sequence[LaserGeometry], config: Config, progress: Progress = no_progress) -> None:
        self.config = config
        self.graph = ScanGraph(config, tuple(geometries))
        self._progress = progress
        self._tracker = Tracker(self.graph.matcher, config)
        self._global = GlobalGrid(self.graph)
        self._loops = LoopSearch(self.graph)
        self._pose = np.zeros(3)
        self._inserted_at = np.full(3, np.inf)
        self._motion_since_node = np.zeros(3)
        self._covariance_at_node = np.zeros((3, 3))
        self._inserted_since_node = 0
        self._strained = False
        self._optimized_at_m = 0.0
        self.optimizations = 0
        self.searched = 0

    def run(self, log: ScanLog) -> ScanGraph:
        """Maps a whole log; the graph, optimized."""
        if log.scans.geometries != tuple(self.graph.scans.geometries):
            raise MapmendError("the log's lasers are not those that this front end was made for")
        total = len(log)
        for k in range(total):
            self._take_scan(log.scans.ranges_of(k), float(log.stamps_s[k]), log.odometry[k], log.scans.laser_of(k))
            if k % 100 == 99 or k == total - 1:
                self._progress("matching", k + 1, total)
        return self.finish()

    def add_scan(self, ranges_m: ArrayLike, stamp_s: float, odometry: ArrayLike | None, laser: int = 0) -> Float:
        """Finds the pose of the next scan and closes loops found with it; returns the current ``T_map_robot`` (3,).

        ``ranges_m`` (beams,): inf for no return, nan for an unusable reading. ``odometry`` (3,):
        ``T_odometry_robot`` at the scan, or None if the configuration does not use it (``motion.use_odometry``).
        ``laser``: which of the geometries. Raises MapmendError for a wrong shape or value; the graph is then unchanged.
        """
        geometries = self.graph.scans.geometries
        if not 0 <= laser < len(geometries):
            raise MapmendError(f"there is no laser {laser}; this front end has {len(geometries)}")
        if odometry is None and self.config.motion.use_odometry:
            raise MapmendError("a scan came without odometry; give one, or set motion.use_odometry to false")
        pose = np.zeros(3) if odometry is None else np.asarray(odometry, dtype=np.float64)
        if pose.shape != (3,) or not np.isfinite(pose).all():
            raise MapmendError(f"odometry must be 3 finite numbers x, y, theta, got {pose}")
        if not math.isfinite(stamp_s):
            raise MapmendError(f"stamp_s must be finite, got {stamp_s}")
        self._take_scan(checked_ranges(ranges_m, geometries[laser]), float(stamp_s), pose, laser)
        return self._pose.copy()

    def finish(self) -> ScanGraph:
        """Optimizes the current graph, as after the last scan; more scans may follow."""
        if self.config.loops.enabled and self.graph.loops:
            self._optimize()
        return self.graph

    def _take_scan(self, ranges_m: Float32, stamp_s: float, odometry: Float, laser: int) -> None:
        """Finds the pose of a scan, makes it a node if the robot moved far enough, and closes the loops of that
        node."""
        graph, odometry = self.graph, se2.to_the_nanometre(odometry)
        if len(graph.hung) == 0:
            self._open_node(ranges_m, laser, self._pose, None)
            graph.hung.hang(stamp_s, odometry, 0, np.zeros(3))
            self._insert(graph.points.project(ranges_m, laser), laser, self._pose)
            return
        motion = self._reported_motion(odometry)
        self._motion_since_node = se2.compose(self._motion_since_node, motion)
        points = graph.points.project(ranges_m, laser)
        tracked = self._tracker.track(self._global.grid, points, self._pose, motion)
        self.searched += tracked.searched
        pose, node = tracked.match.pose, graph.chains.last
        step = se2.between(graph.chains.poses[node], pose)
        if not self._is_far(step):
            graph.hung.hang(stamp_s, odometry, node, step)
        else:
            self._open_node(ranges_m, laser, pose, tracked.match)
            graph.hung.hang(stamp_s, odometry, node + 1, se2.between(pose, pose))
            self._close_loops()
            pose = graph.chains.poses[-1].copy()
            points = graph.points.project(ranges_m, laser)  # the loop search projected other scans in their place
        self._pose = pose
        self._insert(points, laser, pose)

    def _reported_motion(self, odometry: Float) -> Float:
        """The odometry's step to a scan; without odometry, the previous step again."""
        hung = self.graph.hung
        if self.config.motion.use_odometry:
            return se2.between(hung.odometry[-1], odometry)
        if len(hung) < 2:
            return np.zeros(3)
        poses = self.graph.chains.poses
        a, b = (se2.compose(poses[hung.node[row]], hung.T_node_scan[row]) for row in (-2, -1))
        return se2.between(a, b)

    def _is_far(self, step: Float) -> bool:
        settings = self.config.key_nodes
        return bool(math.hypot(step[0], step[1]) >= settings.node_every_m or abs(step[2]) >= settings.node_every_rad)

    def _open_node(self, ranges_m: Float32, laser: int, pose: Float, match: Match | None) -> None:
        """Makes the next scan a node, with an odometry edge that has the covariance of IGO (2)."""
        edge = None
        if match is not None:
            motion = se2.between(self.graph.chains.poses[-1], pose)
            points = self.graph.points.project(ranges_m, laser)
            uncertainty = self.graph.matcher.uncertainty(self._global.grid, points, match)
            edge = OdometryEdge(motion, *self._edge_covariance(uncertainty, match.score))
        self._motion_since_node, self._inserted_since_node = np.zeros(3), 0
        if self.graph.add_node(ranges_m, laser, pose, edge):
            self._global.refresh()

    def _edge_covariance(self, newest: Uncertainty, score: float) -> tuple[Float, Float]:
        """IGO (2) of the edge to the newest match, and its drift. Both ends were matched, with independent noise."""
        odometry = odometry_covariance(self._motion_since_node, self.config.motion)
        carry = se2.adjoint(se2.inverse(self._motion_since_node))
        both = newest.covariance + carry @ self._covariance_at_node @ carry.T
        self._covariance_at_node = newest.covariance
        renewed = newest.renewed_by(self._inserted_since_node)
        return edge_covariance(both, renewed, odometry, score, self.config.match.min_score)

    def _insert(self, points: Float, laser: int, pose: Float) -> None:
        """Puts a scan into the global grid unless the last one was inserted at nearly the same pose (3,)."""
        grid = self.config.grid
        step = pose - self._inserted_at
        near = math.hypot(step[0], step[1]) < grid.insert_every_m
        if near and abs(math.remainder(step[2], math.tau)) < grid.insert_every_rad:
            return
        self._global.grid.insert(points, self.graph.points.origin_of(laser), pose)
        self._inserted_at = pose
        self._inserted_since_node += 1

    def _close_loops(self) -> None:
        """Searches loops of the newest node; optimizes if a new key-node was linked or if edges are strained."""
        if not self.config.loops.enabled:
            return
        graph, known = self.graph, self.graph.key_nodes.known()
        closed = False
        for edge in self._loops.find():
            graph.loops.append(edge)
            k = int(graph.key_nodes.of_node[edge.anchor])
            closed |= k not in known
            self._strained |= self._is_strained(edge)
            graph.key_nodes.link(k, graph.key_nodes.last, 0.0)
        rested = float(graph.chains.path_m[-1]) - self._optimized_at_m > self.config.key_nodes.trajectory_length_m
        if closed or (self._strained and rested):
            moved = self._optimize()
            if moved:
                self._global.rebuild()
            else:
                self._global.refresh()
            self._inserted_at = np.full(3, np.inf)

    def _is_strained(self, edge: LoopEdge) -> bool:
        poses = self.graph.chains.poses
        error = se2.between(edge.T_anchor_node, se2.between(poses[edge.anchor], poses[edge.node]))
        loops = self.config.loops
        return bool(np.hypot(error[0], error[1]) > loops.strain_m or abs(error[2]) > loops.strain_rad)

    def _optimize(self) -> bool:
        """Optimizes the current graph; True if a node moved enough to rebuild the grids."""
        chains = self.graph.chains
        result = optimize(self.graph.pose_graph())
        step = se2.between(chains.poses, result.poses)
        chains.move(result.poses)
        self._loops.solved = Solved.from_factor(result.factorization, result.poses)
        self._optimized_at_m = float(chains.path_m[-1])
        self._strained = False
        self.optimizations += 1
        return bool((np.hypot(step[:, 0], step[:, 1]) > STILL_M).any() or (np.abs(step[:, 2]) > STILL_RAD).any())
