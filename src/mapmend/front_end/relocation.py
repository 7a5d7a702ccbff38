"""Where the robot stands on the map of long ago, once drift may have carried it farther than loops are searched.

Ours, not the paper's, whose loop search looks at key-nodes one by one: that grows with their number and with the area.
Here the last stretch of the trajectory, as one cloud of points, is searched on one grid of all that was seen long ago.
What is found is only where to look: a loop edge is matched, verified and confirmed there like any other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.front_end.global_grid import ORIGIN, representatives
from mapmend.front_end.key_nodes import KeyNodes
from mapmend.front_end.points import ScanPoints
from mapmend.front_end.state import Float, GraphState
from mapmend.geometry import se2
from mapmend.grid.likelihood import likelihood_field
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.correlative import Region, search
from mapmend.matching.gauss_newton import SurfaceMatcher

Int = NDArray[np.int64]

# So many T_l of trajectory are searched for: the wider the area, the more must agree.
STRETCH = 2.0
# The loop search reaches no farther than so many T_l, and no search turns farther: cost and chance look-alikes grow.
MOST_DRIFT = 2.0
MOST_TURN_RAD = 0.6


class Relocation:
    """Searches the old map for the newest node."""

    def __init__(
        self, state: GraphState, key_nodes: KeyNodes, points: ScanPoints, matcher: SurfaceMatcher, config: Config
    ) -> None:
        self._state = state
        self._key_nodes = key_nodes
        self._points = points
        self._matcher = matcher
        self._config = config
        self._tried_at_m = 0.0

    def find(self) -> Float | None:
        """``T_map_robot`` (3,) of the newest node on the old map, or None; looks once every T_l of trajectory."""
        state, config, loops = self._state, self._config, self._config.loops
        length, path = config.key_nodes.trajectory_length_m, float(state.node_path_m[state.last])
        if path - self._tried_at_m < length:
            return None
        self._tried_at_m = path
        nodes, radius_m = self._long_ago()
        if len(nodes) == 0:
            return None
        grid = SurfaceGrid(config.grid.cell_size_m)
        self._key_nodes.insert_nodes(grid, nodes[representatives(state.node_pose[nodes], {})], ORIGIN)
        points = recent_points(state, self._points, STRETCH * length)
        here = state.node_pose[state.last]
        region = Region(here, here[None, :2], radius_m, MOST_TURN_RAD, loops.tie_weight, radius_m, MOST_TURN_RAD)
        found = search(likelihood_field(grid, config.match.half_weight_m), points, region, loops.min_likelihood)
        if found is None:
            return None
        match = self._matcher.match(grid, points, found[0])
        matched, contradicted, _ = self._matcher.judge(grid, points, match.pose)
        seen = matched + contradicted
        agrees = seen >= loops.min_overlap * len(points) and matched >= loops.min_agreement * seen
        return match.pose if agrees else None

    def _long_ago(self) -> tuple[Int, float]:
        """The nodes where the robot may be although it believes to be elsewhere, and how far off the farthest may be.

        Drift grows with the way along the graph, loops counting as none. Those that it can't have carried beyond the
        reach of the loop search are left to that.
        """
        state, loops, key_nodes = self._state, self._config.loops, self._key_nodes
        ways = key_nodes.distances(key_nodes.last, np.inf)
        reach = np.zeros(len(key_nodes.rows))
        reach[list(ways)] = np.minimum(3.0 * loops.drift_per_m * np.array(list(ways.values())), loops.farthest_m)
        reach[reach <= MOST_DRIFT * self._config.key_nodes.trajectory_length_m] = 0.0
        poses = state.node_pose[: state.count]
        here = poses[-1]
        of_node = reach[key_nodes.of_node[: state.count]]
        nodes = np.flatnonzero(np.hypot(poses[:, 0] - here[0], poses[:, 1] - here[1]) < of_node)
        return nodes, float(of_node[nodes].max(initial=0.0))


def recent_points(state: GraphState, points: ScanPoints, length_m: float, last: int | None = None) -> Float:
    """Every third point of the ``length_m`` up to node ``last``, or to the newest, in its frame; shape (n, 5)."""
    last = state.last if last is None else last
    path = state.node_path_m[: last + 1]
    first = int(np.searchsorted(path, path[-1] - length_m))
    parts = []
    for node in range(first, last + 1):
        pose = se2.between(state.node_pose[last], state.node_pose[node])
        part = points.of(int(state.node_scan[node]))[::3]
        normals = se2.transform_points(np.array([0.0, 0.0, pose[2]]), part[:, 2:4])
        parts.append(np.concatenate((se2.transform_points(pose, part[:, :2]), normals, part[:, 4:]), axis=1))
    return np.ascontiguousarray(np.concatenate(parts))
