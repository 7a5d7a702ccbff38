"""Key-nodes: stretches of the trajectory with a local grid each. IGO section III-B."""

from __future__ import annotations

import heapq
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.front_end.points import ScanPoints
from mapmend.front_end.state import Float, GraphState
from mapmend.geometry import se2
from mapmend.grid.likelihood import LikelihoodField, likelihood_field
from mapmend.grid.surface import SurfaceGrid

KEPT_GRIDS = 12


@dataclass
class KeyNode:
    """The nodes ``first`` to ``end - 1``; the first gives the frame of its local grid."""

    first: int
    end: int


@dataclass
class LocalGrid:
    """A key-node's grid, and the likelihood field made from it when first asked for.

    Its frame is that of the key-node's first node; ``poses`` (n, 3) are those that the nodes from ``begin`` on had in
    that frame when the grid was built from them, and still have in it whatever the optimizer did to the map since.
    """

    grid: SurfaceGrid
    begin: int
    poses: Float
    field: LikelihoodField | None = None


class KeyNodes:
    """All key-nodes, what links them, and the local grids that were asked for last.

    A local grid is built from the scans when a loop search first wants it, and at most ``KEPT_GRIDS`` are kept: memory
    does not grow with the log.
    """

    def __init__(self, state: GraphState, points: ScanPoints, config: Config) -> None:
        self.rows: list[KeyNode] = []
        self._firsts = np.zeros(len(state.node_pose), dtype=np.int64)
        self.of_node = np.zeros(len(state.node_pose), dtype=np.int64)
        self._state = state
        self._points = points
        self._config = config
        self._links: list[dict[int, float]] = []
        self._known: dict[int, dict[int, float]] = {}
        self._grids: OrderedDict[int, LocalGrid] = OrderedDict()

    @property
    def last(self) -> int:
        return len(self.rows) - 1

    def firsts(self) -> NDArray[np.int64]:
        """The first node of every key-node, shape (n,), rising."""
        return self._firsts[: len(self.rows)]

    def add_node(self, node: int) -> bool:
        """Puts the newest node into the current key-node, or opens a new one with it: then True."""
        state = self._state
        length = self._config.key_nodes.trajectory_length_m
        opens = not self.rows or state.node_path_m[node] - state.node_path_m[self.rows[-1].first] > length
        if opens:
            self._firsts[len(self.rows)] = node
            self.rows.append(KeyNode(node, node))
            self._links.append({})
            if self.last > 0:
                self.link(self.last - 1, self.last, length)
            self._known.clear()
        self.rows[-1].end = node + 1
        self.of_node[node] = self.last
        return opens

    def link(self, a: int, b: int, length_m: float) -> None:
        """Says that a and b are known relative to each other: neighbours by T_l, a verified loop by nothing."""
        if length_m < self._links[a].get(b, np.inf):
            self._links[a][b] = self._links[b][a] = length_m
            self._known.clear()

    def known(self) -> dict[int, float]:
        """The key-nodes whose relation to the current one is known, and how far along links they are, metres.

        Those within the members' length of it: they take part in the global grid, and their loops need no search.
        """
        if self.last not in self._known:
            self._known[self.last] = self.distances(self.last, self._config.key_nodes.member_length_m)
        return self._known[self.last]

    def distances(self, start: int, limit_m: float) -> dict[int, float]:
        """How far along links every key-node within ``limit_m`` of ``start`` is, metres of trajectory."""
        found: dict[int, float] = {}
        queue = [(0.0, start)]
        while queue:
            d, k = heapq.heappop(queue)
            if k in found:
                continue
            found[k] = d
            for other, length in self._links[k].items():
                if other not in found and d + length <= limit_m:
                    heapq.heappush(queue, (d + length, other))
        return found

    def local_grid(self, k: int) -> LocalGrid:
        """The local grid of key-node k: its nodes' scans and half as many of its neighbours'."""
        kept = self._grids.get(k)
        if kept is not None and kept.begin + len(kept.poses) >= self.rows[k].end:
            self._grids.move_to_end(k)
            return kept
        state = self._state
        anchor = self.rows[k].first
        grid = SurfaceGrid(self._config.grid.cell_size_m)
        half = 0.5 * self._config.key_nodes.trajectory_length_m
        path = state.node_path_m[: state.count]
        first = int(np.searchsorted(path, path[anchor] - half))
        end = int(np.searchsorted(path, path[self.rows[k].end - 1] + half, side="right"))
        self.insert_nodes(grid, np.arange(first, end), state.node_pose[anchor])
        self._grids[k] = LocalGrid(grid, first, se2.between(state.node_pose[anchor], state.node_pose[first:end]))
        if len(self._grids) > KEPT_GRIDS:
            self._grids.popitem(last=False)
        return self._grids[k]

    def forget_grids(self) -> None:
        """After nodes moved within their key-nodes: local grids are built anew when asked for (IGO IV-C, line 22)."""
        self._grids.clear()

    def likelihood(self, k: int) -> LikelihoodField:
        """The likelihood field of the local grid of key-node k."""
        local = self.local_grid(k)
        if local.field is None:
            local.field = likelihood_field(local.grid, self._config.match.half_weight_m)
        return local.field

    def insert_nodes(self, grid: SurfaceGrid, nodes: NDArray[np.int64], frame: Float) -> None:
        """Puts the scans of ``nodes`` into ``grid``, whose frame stands at ``frame`` (3,) in the map."""
        state, points = self._state, self._points
        poses = se2.between(frame, state.node_pose[nodes])
        for pose, scan in zip(poses, state.node_scan[nodes], strict=True):
            grid.insert(points.of(int(scan)), points.laser_origin(int(scan)), pose)
