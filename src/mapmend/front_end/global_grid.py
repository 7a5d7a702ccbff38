"""The global grid M_g that scans are tracked on, and which key-nodes take part in it.

The paper's M_g holds the whole map. Where the robot comes back with drift, that would show every wall twice until the
loop has closed. Here M_g holds the key-nodes whose relation to the robot is known well: those within a length of the
current one along the trajectory, verified loops counting as no way at all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.front_end.key_nodes import KeyNodes
from mapmend.front_end.state import Float, GraphState
from mapmend.grid.surface import SurfaceGrid

CROWD = 1
SPOT_M = 1.0
SPOT_RAD = 0.7
ORIGIN = np.zeros(3)


class GlobalGrid:
    """The grid, and the key-nodes whose scans are in it."""

    def __init__(self, state: GraphState, key_nodes: KeyNodes, config: Config) -> None:
        self.grid = SurfaceGrid(config.grid.cell_size_m)
        self._state = state
        self._key_nodes = key_nodes
        self._config = config
        self._contents: set[int] = set()
        self._crowd: dict[tuple[int, ...], int] = {}

    def refresh(self) -> None:
        """After a key-node was opened or linked: lets in who is known now, and turns out who is not and in the way."""
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
        """Builds the grid anew from its members' scans where the optimizer put them."""
        self.grid.clear()
        self._contents = set()
        self._crowd = {}
        for k in sorted(self._key_nodes.known()):
            if k == self._key_nodes.last or self._is_near(k):
                self._insert(k)

    def _insert(self, k: int) -> None:
        row = self._key_nodes.rows[k]
        nodes = np.arange(row.first, row.end)
        room = representatives(self._state.node_pose[nodes], self._crowd)
        self._key_nodes.insert_nodes(self.grid, nodes[room], ORIGIN)
        self._contents.add(k)

    def _is_near(self, k: int) -> bool:
        row = self._key_nodes.rows[k]
        here = self._state.node_pose[self._state.last]
        poses = self._state.node_pose[row.first : row.end]
        return bool((np.hypot(poses[:, 0] - here[0], poses[:, 1] - here[1]) < self._config.key_nodes.near_m).any())


def representatives(poses: Float, crowd: dict[tuple[int, ...], int]) -> NDArray[np.bool_]:
    """Which of ``poses`` (n, 3) show something new: at most ``CROWD`` from a spot in one direction.

    So the cost of building a grid follows the area, not the length of the log. ``crowd`` counts spots, and is written.
    """
    room = np.zeros(len(poses), dtype=np.bool_)
    for row, spot in enumerate(map(tuple, np.floor(poses / (SPOT_M, SPOT_M, SPOT_RAD)).astype(np.int64).tolist())):
        crowd[spot] = crowd.get(spot, 0) + 1
        room[row] = crowd[spot] <= CROWD
    return room
