"""The global grid M_g that scans are tracked on, and which key-nodes take part in it.

The paper's M_g holds the whole map. When the robot comes back with drift, such a grid would show every wall twice until
the loop has closed. Here M_g holds the key-nodes whose pose relative to the robot is known well: those within a length
of the current one along the trajectory, where verified loops count nothing.
"""

from __future__ import annotations

import numpy as np

from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.scan_graph.node_grids import ORIGIN, insert_nodes, representatives
from mapmend.scan_graph.scan_graph import ScanGraph


class GlobalGrid:
    """The grid, and the key-nodes whose scans are in it."""

    def __init__(self, graph: ScanGraph) -> None:
        self.grid = SurfaceGrid(graph.config.grid.cell_size_m)
        self._graph = graph
        self._key_nodes = graph.key_nodes
        self._near_m = graph.config.key_nodes.near_m
        self._contents: set[int] = set()
        self._crowd: dict[tuple[int, ...], int] = {}

    def refresh(self) -> None:
        """After a key-node was opened or linked: inserts those that are known now, and removes near ones that are
        not."""
        members = set(self._key_nodes.known())
        strangers = [k for k in self._contents - members if self._is_near(k)]
        if strangers:
            self.rebuild()
            return
        for k in sorted(members - self._contents):
            if k == self._key_nodes.last:
                self._contents.add(k)  # its scans are being inserted one by one
            elif self._is_near(k):
                self._insert(k)

    def rebuild(self) -> None:
        """Rebuilds the grid from its members' scans at the optimizer's poses."""
        self.grid.clear()
        self._contents = set()
        self._crowd = {}
        for k in sorted(self._key_nodes.known()):
            if k == self._key_nodes.last or self._is_near(k):
                self._insert(k)

    def _insert(self, k: int) -> None:
        row, poses = self._key_nodes.rows[k], self._graph.chains.poses
        nodes = np.arange(row.first, row.end)
        nodes = nodes[representatives(poses[nodes], self._graph.config.grid, self._crowd)]
        insert_nodes(self.grid, self._graph.points, nodes, se2.between(ORIGIN, poses[nodes]))
        self._contents.add(k)

    def _is_near(self, k: int) -> bool:
        row, chains = self._key_nodes.rows[k], self._graph.chains
        here = chains.poses[chains.last]
        poses = chains.poses[row.first : row.end]
        return bool((np.hypot(poses[:, 0] - here[0], poses[:, 1] - here[1]) < self._near_m).any())
