"""Where the optimizer starts: the poses as given, along the odometry, along a spanning tree, or rotations first.

Gauss-Newton finds the optimum in whose valley it starts. The rotations decide which valley this is: the translations
follow from them by a linear system. The chordal start takes the rotations from a linear system too.
"""

from __future__ import annotations

import math

import numpy as np

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.checks import check_numbers
from mapmend.graph.pose_graph import Float, Int, PoseGraph
from mapmend.graph.spanning_tree import best_first, poses_along_tree
from mapmend.graph.system import System

STARTS = ("given", "odometry", "tree", "chordal")


def starting_poses(graph: PoseGraph, start: str, system: System | None = None) -> Float:
    """The poses to start from, shape (n, 3); those of the fixed nodes are the graph's own. ``start``: one of STARTS.

    ``system``: that of the same edges and fixed nodes, if there is one yet. Raises ``MapmendError`` for other starts,
    for a graph without odometry if the start is along it, and for graphs that cannot be optimized.
    """
    if start not in STARTS:
        raise MapmendError(f"the start must be one of {', '.join(STARTS)}, got {start!r}")
    if start == "given":
        return graph.poses.copy()
    check_numbers(graph)
    system = System(graph) if system is None else system
    if start == "odometry":
        return along_odometry(graph)
    if start == "tree":
        return along_tree(graph)
    return chordal(graph, system)


def along_odometry(graph: PoseGraph) -> Float:
    """From the fixed nodes along the first edge between each node and the next, in the order of the nodes.

    Raises ``MapmendError`` where two nodes that follow each other have no edge between them.
    """
    count, poses = len(graph), graph.poses.copy()
    i, j = graph.edges.T
    steps = np.full((count, 3), np.nan)
    backward, forward = np.flatnonzero(i == j + 1)[::-1], np.flatnonzero(j == i + 1)[::-1]
    steps[j[backward]] = se2.inverse(graph.measurements[backward])
    steps[i[forward]] = graph.measurements[forward]
    missing = np.isnan(steps[: max(count - 1, 0), 0])
    if missing.any():
        node = int(np.argmax(missing))
        raise MapmendError(
            f"no edge joins node {graph.ids[node]} to the next, {graph.ids[node + 1]}: "
            "the graph has no odometry to start along; start along a tree"
        )
    anchors = sorted(graph.fixed)
    for first, end in zip(anchors, [*anchors[1:], count], strict=True):
        poses[first:end] = _chained(poses[first], steps[first : end - 1])
    back = se2.inverse(steps[: anchors[0]][::-1]) if anchors else steps[:0]
    poses[: len(back)] = _chained(poses[anchors[0]], back)[:0:-1] if len(back) else poses[:0]
    return poses


def _chained(start: Float, steps: Float) -> Float:
    """The pose after each of the steps, the start first, shape (steps + 1, 3)."""
    poses = np.concatenate((start[None], steps))
    poses[:, 2] = np.cumsum(poses[:, 2])
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    poses[1:, 0] = start[0] + np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    poses[1:, 1] = start[1] + np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    poses[1:, 2] = se2.wrap_angle(poses[1:, 2])
    return poses


def along_tree(graph: PoseGraph) -> Float:
    """From the fixed nodes along the tree of the best edges: those with the greatest determinant of the information.

    Among equally good edges, odometry comes before loops, then the edge that is earlier in the graph.
    """
    known = np.zeros(len(graph), np.bool_)
    known[list(graph.fixed)] = True
    preference = best_first(graph.information, graph.is_loop)
    return poses_along_tree(graph.poses, known, graph.edges, graph.measurements, preference)


def chordal(graph: PoseGraph, system: System) -> Float:
    """Rotations first, without regard to translations; then the translations that agree best with them.

    A rotation is a point (cos, sin) that may leave its circle: a linear system minimizes ``sum w |z_j - R_m z_i|^2``,
    where w is the information on the angle alone. Then each point is projected back to its circle (Martinec and Pajdla
    2007; Carlone, Tron, Daniilidis and Dellaert 2015, "Initialization techniques for 3D SLAM", chordal relaxation).
    """
    i = graph.edges[:, 0]
    poses = graph.poses.copy()
    turns = np.stack((np.cos(poses[:, 2]), np.sin(poses[:, 2])), axis=1)
    weights = (1.0 / np.linalg.inv(graph.information)[:, 2, 2])[:, None, None]
    same = np.broadcast_to(weights * np.eye(2), (len(i), 2, 2))
    nothing = np.zeros((len(i), 2))
    turns = _least_squares(system, turns, same, weights * _rotations(graph.measurements[:, 2]), nothing)
    free = system.nodes
    poses[free, 2] = np.arctan2(turns[free, 1], turns[free, 0])

    into_map = _rotations(poses[i, 2])
    steps = np.einsum("mab,mb->ma", into_map, graph.measurements[:, :2])
    into_map = into_map @ _rotations(graph.measurements[:, 2])
    weights = into_map @ graph.information[:, :2, :2] @ np.swapaxes(into_map, 1, 2)
    pull = np.einsum("mab,mb->ma", weights, steps)
    poses[:, :2] = _least_squares(system, poses[:, :2], weights, weights, pull)
    return poses


def _least_squares(system: System, known: Float, on_ends: Float, between: Float, pull: Float) -> Float:
    """The points, shape (n, 2), that solve the sum of the edges' equations; fixed nodes keep theirs.

    The part of an edge: ``on_ends`` on the diagonal at both ends, ``-between`` in the rows of j and the columns of i,
    each (m, 2, 2), and on the right side ``pull`` for j and ``-pull`` for i, shape (m, 2). The third unknown of each
    node is not coupled to any other, so that the elimination of the graph's own equations can be used.
    """
    i, j = system.edges.T
    place_i, place_j = system.places[i], system.places[j]
    free_i, free_j = place_i >= 0, place_j >= 0
    both = free_i & free_j
    count, blocks = len(system.nodes), len(system.elimination.fronts.block_rows)
    values = np.zeros((count + blocks, 3, 3))
    values[:count, 2, 2] = 1.0
    corner = values[:, :2, :2]
    rows = np.concatenate((place_i[free_i], place_j[free_j]))
    corner[:count] = _sums(rows, np.concatenate((on_ends[free_i], on_ends[free_j])), count)
    # A block is stored by columns; its row is the end that is eliminated later.
    later_j = (place_j > place_i)[both, None, None]
    stored = np.where(later_j, np.swapaxes(between[both], 1, 2), between[both])
    corner[count:] = -_sums(system.elimination.block_of_edge[both], stored, blocks)

    right_side = np.zeros((len(known), 3))
    ahead, back = pull.copy(), -pull
    ahead[~free_i] += np.einsum("mab,mb->ma", between[~free_i], known[i[~free_i]])
    back[~free_j] += np.einsum("mba,mb->ma", between[~free_j], known[j[~free_j]])
    right_side[:, :2] = _sums(np.concatenate((j, i)), np.concatenate((ahead, back)), len(known))
    found = known.copy()
    found[system.nodes] = system.solve(values.ravel(), right_side[system.nodes].ravel()).reshape(-1, 3)[:, :2]
    return found


def _sums(rows: Int, values: Float, count: int) -> Float:
    """The sum of the values (k, ...) of each row, shape (count, ...); ``rows``: shape (k,), below ``count``."""
    columns = values.reshape(len(values), math.prod(values.shape[1:])).T
    sums: Float = np.array([np.bincount(rows, weights=column, minlength=count) for column in columns], np.float64)
    return sums.T.reshape(count, *values.shape[1:])


def _rotations(angles: Float) -> Float:
    """Rotation matrices, shape (k, 2, 2)."""
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack((np.stack((cos, -sin), axis=-1), np.stack((sin, cos), axis=-1)), axis=-2)
