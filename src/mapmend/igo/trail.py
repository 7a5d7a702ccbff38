"""The rebuilt global grid: the trail of nodes before the one that is matched, at their current poses. IGO's M_g."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.grid.surface import SurfaceGrid
from mapmend.scan_graph.node_grids import insert_nodes, representatives
from mapmend.scan_graph.scan_graph import ScanGraph

Float = NDArray[np.float64]

# A grid that lacks more of the last nodes is rebuilt: inserting them one by one would take as long.
MOST_BEHIND = 8


class TrailGrid:
    """A grid of the nodes before a node, as far back as key-nodes take part in the front end's grid.

    It is rebuilt at every key-node and when nodes are skipped; in between, nodes are added one by one. No loop takes
    part: an odometry edge is measured only against the path by which the robot came.
    """

    def __init__(self, graph: ScanGraph) -> None:
        self.grid = SurfaceGrid(graph.config.grid.cell_size_m)
        self._settings = graph.config.grid
        self._chains = graph.chains
        self._points = graph.points
        self._length_m = graph.config.key_nodes.member_length_m
        self._every_m = graph.config.key_nodes.trajectory_length_m
        self._begin = -1
        self._end = -1
        self._begun_at_m = 0.0

    def before(self, node: int, poses: Float) -> SurfaceGrid:
        """The grid of the nodes before ``node`` on its chain, at ``poses`` (n, 3)."""
        path, (begin, _) = self._chains.path_m, self._chains.chain_of(node)
        stale = path[node] - self._begun_at_m > self._every_m
        if begin != self._begin or self._end > node or stale or node - self._end > MOST_BEHIND:
            first, _ = self._chains.within(node, self._length_m, 0.0)
            nodes = np.arange(node - 1, first - 1, -1)
            nodes = np.sort(nodes[representatives(poses[nodes], self._settings, {})])
            self.grid.clear()
            self._begun_at_m = float(path[node])
        else:
            nodes = np.arange(self._end, node)
        insert_nodes(self.grid, self._points, nodes, poses[nodes])
        self._begin, self._end = begin, node
        return self.grid
