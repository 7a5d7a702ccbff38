"""Relocation: finds the robot on an old part of the map when the drift may exceed the reach of the loop search.

This is ours, not the paper's. The paper's loop search tests key-nodes one by one; its cost grows with their number and
with the area. Here the last stretch of the trajectory, as one cloud of points, is searched on one grid of all that was
seen long ago. The result is only a guess: a loop edge is matched, verified and confirmed there like any other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.grid.likelihood import likelihood_field
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.correlative import Region, search
from mapmend.scan_graph.node_grids import ORIGIN, insert_nodes, recent_points, representatives
from mapmend.scan_graph.scan_graph import ScanGraph

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# The length of the stretch that is searched for, in T_l: the wider the area, the more points must agree.
STRETCH = 2.0
# The loop search reaches at most this many T_l beyond T_l: farther searches take longer and find more places that look
# alike by chance.
MOST_DRIFT = 2.0


class Relocation:
    """Searches the old map for the newest node."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._tried_at_m = 0.0

    def find(self) -> Float | None:
        """``T_map_robot`` (3,) of the newest node on the old map, or None; searches once every T_l of trajectory."""
        graph, chains, config = self._graph, self._graph.chains, self._graph.config
        length, path, loops = config.key_nodes.trajectory_length_m, float(chains.path_m[-1]), config.loops
        if path - self._tried_at_m < length:
            return None
        self._tried_at_m = path
        nodes, radius_m = self._long_ago()
        if len(nodes) == 0:
            return None
        grid = SurfaceGrid(config.grid.cell_size_m)
        nodes = nodes[representatives(chains.poses[nodes], config.grid, {})]
        insert_nodes(grid, graph.points, nodes, se2.between(ORIGIN, chains.poses[nodes]))
        points = recent_points(chains, graph.points, STRETCH * length, chains.last)
        here, turn = chains.poses[-1], loops.most_turn_rad
        region = Region(here, here[None, :2], radius_m, turn, loops.tie_weight, radius_m, turn)
        found = search(likelihood_field(grid.tiles, config.match.half_weight_m), points, region, loops.min_likelihood)
        if found is None:
            return None
        match = graph.matcher.match(grid, points, found[0])
        agreement = graph.loop_edges.agreement(grid, points, match.pose)
        agrees = graph.loop_edges.overlaps(agreement) and graph.loop_edges.agrees(agreement)
        return match.pose if agrees else None

    def _long_ago(self) -> tuple[Int, float]:
        """The nodes near which the robot may be in spite of its current pose, and the greatest possible drift.

        Drift grows with the path along the graph, where loops count nothing. Nodes whose drift cannot exceed the reach
        of the loop search are left to the loop search.
        """
        loops, key_nodes, poses = self._graph.config.loops, self._graph.key_nodes, self._graph.chains.poses
        ways = key_nodes.distances(key_nodes.last, np.inf)
        reach = np.zeros(len(key_nodes.rows))
        reach[list(ways)] = np.minimum(3.0 * loops.drift_per_m * np.array(list(ways.values())), loops.farthest_m)
        reach[reach <= MOST_DRIFT * self._graph.config.key_nodes.trajectory_length_m] = 0.0
        here = poses[-1]
        of_node = reach[key_nodes.of_node]
        nodes = np.flatnonzero(np.hypot(poses[:, 0] - here[0], poses[:, 1] - here[1]) < of_node)
        return nodes, float(of_node[nodes].max(initial=0.0))
