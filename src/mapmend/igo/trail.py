"""The rebuilt global grid: the trail of nodes behind the one that is matched, at the poses of now. IGO's M_g."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.front_end.global_grid import representatives
from mapmend.front_end.points import ScanPoints
from mapmend.front_end.state import Float, GraphState
from mapmend.grid.surface import SurfaceGrid


class TrailGrid:
    """A grid of the nodes before a node, as far back as the front end's key-nodes take part in its own.

    It is built anew at every key-node and when nodes are skipped; in between, nodes are added one by one. No loop takes
    part: an odometry edge is measured against where the robot came from, whatever the loops say.
    """

    def __init__(self, state: GraphState, points: ScanPoints, config: Config) -> None:
        self.grid = SurfaceGrid(config.grid.cell_size_m)
        self._state = state
        self._points = points
        self._length_m = config.key_nodes.member_length_m
        self._every_m = config.key_nodes.trajectory_length_m
        self._end = -1
        self._begun_at_m = 0.0

    def before(self, node: int, poses: Float) -> SurfaceGrid:
        """The grid of the nodes before ``node`` at ``poses`` (n, 3)."""
        path = self._state.node_path_m
        stale = path[node] - self._begun_at_m > self._every_m
        if self._end < 0 or self._end > node or stale or node - self._end > 8:
            first = int(np.searchsorted(path[:node], path[node] - self._length_m))
            nodes = np.arange(node - 1, first - 1, -1)
            room = representatives(poses[nodes], {})
            self.grid.clear()
            self._insert(np.sort(nodes[room]), poses)
            self._begun_at_m = float(path[node])
        else:
            self._insert(np.arange(self._end, node), poses)
        self._end = node
        return self.grid

    def _insert(self, nodes: NDArray[np.int64], poses: Float) -> None:
        for node in nodes:
            scan = int(self._state.node_scan[node])
            self.grid.insert(self._points.of(scan), self._points.laser_origin(scan), poses[node])
