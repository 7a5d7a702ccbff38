"""Key-nodes: stretches of the trajectory with a local grid each. IGO section III-B."""

from __future__ import annotations

import heapq
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.grid.likelihood import LikelihoodField, likelihood_field
from mapmend.grid.surface import SurfaceGrid
from mapmend.scan_graph.chains import Chains
from mapmend.scan_graph.growing import GrowingArray
from mapmend.scan_graph.node_grids import insert_nodes
from mapmend.scan_graph.points import ScanPoints

Float = NDArray[np.float64]

KEPT_GRIDS = 12


@dataclass
class KeyNode:
    """The nodes ``first`` to ``end - 1``; the first gives the frame of its local grid."""

    first: int
    end: int


@dataclass
class LocalGrid:
    """A key-node's grid, and its likelihood field, which is made when it is first needed.

    Its frame is that of the key-node's first node; ``poses`` (n, 3) are those of the nodes from ``begin`` on in that
    frame when the grid was built; the optimizer does not change them.
    """

    grid: SurfaceGrid
    begin: int
    poses: Float
    field: LikelihoodField | None = None


class KeyNodes:
    """All key-nodes, their links, and the local grids that were used last.

    A local grid is built from the scans when a loop search first needs it, and at most ``KEPT_GRIDS`` are kept: memory
    does not grow with the log.
    """

    def __init__(self, chains: Chains, points: ScanPoints, config: Config) -> None:
        self.rows: list[KeyNode] = []
        self._firsts = GrowingArray(dtype=np.int64)
        self._of_node = GrowingArray(dtype=np.int64)
        self._chains = chains
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
        return self._firsts.rows

    @property
    def of_node(self) -> NDArray[np.int64]:
        """Which key-node each node belongs to, shape (nodes,)."""
        return self._of_node.rows

    def add_node(self, node: int) -> bool:
        """Puts the newest node into the current key-node, or opens a new one with it and returns True.

        A new one is opened after T_l of trajectory, and where a chain begins: only loops link the latter.
        """
        path, length = self._chains.path_m, self._config.key_nodes.trajectory_length_m
        begins = self._chains.chain_of(node)[0] == node
        opens = begins or path[node] - path[self.rows[-1].first] > length
        if opens:
            self._firsts.append(node)
            self.rows.append(KeyNode(node, node))
            self._links.append({})
            if not begins:
                self.link(self.last - 1, self.last, length)
            self._known.clear()
        self.rows[-1].end = node + 1
        self._of_node.append(self.last)
        return bool(opens)

    def link(self, a: int, b: int, length_m: float) -> None:
        """Links a and b, whose relative pose is known: the link counts T_l for neighbours, nothing for a verified
        loop."""
        if length_m < self._links[a].get(b, np.inf):
            self._links[a][b] = self._links[b][a] = length_m
            self._known.clear()

    def known(self) -> dict[int, float]:
        """The key-nodes whose pose relative to the current one is known, and their distance along links, metres.

        These are those within the members' length: they take part in the global grid, and their loops need no search.
        """
        if self.last not in self._known:
            self._known[self.last] = self.distances(self.last, self._config.key_nodes.member_length_m)
        return self._known[self.last]

    def distances(self, start: int, limit_m: float) -> dict[int, float]:
        """The distance along links of every key-node within ``limit_m`` of ``start``, metres of trajectory."""
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
        chains, row = self._chains, self.rows[k]
        half_m = 0.5 * self._config.key_nodes.trajectory_length_m
        first, _ = chains.within(row.first, half_m, 0.0)
        _, end = chains.within(row.end - 1, 0.0, half_m)
        poses = se2.between(chains.poses[row.first], chains.poses[first:end])
        grid = SurfaceGrid(self._config.grid.cell_size_m)
        insert_nodes(grid, self._points, range(first, end), poses)
        self._grids[k] = LocalGrid(grid, first, poses)
        if len(self._grids) > KEPT_GRIDS:
            self._grids.popitem(last=False)
        return self._grids[k]

    def forget_grids(self) -> None:
        """After nodes moved within their key-nodes: local grids are rebuilt when needed (IGO IV-C, line 22)."""
        self._grids.clear()

    def likelihood(self, k: int) -> LikelihoodField:
        """The likelihood field of the local grid of key-node k."""
        local = self.local_grid(k)
        if local.field is None:
            local.field = likelihood_field(local.grid.tiles, self._config.match.half_weight_m)
        return local.field
