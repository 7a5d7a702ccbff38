"""Poses along a spanning tree of edges: a start for the optimizer, and poses for nodes to which a file gives none."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import Float, Int, PoseGraph


def poses_along_tree(poses: Float, known: NDArray[np.bool_], edges: Int, measurements: Float, preference: Int) -> Float:
    """The poses, shape (n, 3), of all nodes with a chain of edges to a known one; the others keep their poses.

    ``known``: bool, shape (n,), the nodes that stay. ``edges`` (m, 2), ``measurements`` (m, 3): as in ``PoseGraph``.
    ``preference``: shape (m,), the rows of the edges, the best first: the tree is the one that takes the best edges.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    count, ends = len(poses), edges.copy()
    ends[known[ends]] = count  # all known nodes are one root
    pairs = ends.min(axis=1) * (count + 1) + ends.max(axis=1)
    _, first = np.unique(pairs[preference], return_index=True)
    ranks, chosen = first + 1.0, preference[first]
    apart = ends[chosen, 0] != ends[chosen, 1]
    ranks, chosen = ranks[apart], chosen[apart]
    links = coo_array((ranks, ends[chosen].T), shape=(count + 1, count + 1))
    tree = minimum_spanning_tree(links)
    order, parents = breadth_first_order(tree, count, directed=False)
    edge_of = dict(zip(pairs[chosen].tolist(), chosen.tolist(), strict=True))
    rows = poses.tolist()
    inverses = se2.inverse(measurements).tolist()
    steps, joined = measurements.tolist(), edges.tolist()
    for node, parent in zip(order[1:].tolist(), parents[order[1:]].tolist(), strict=True):
        edge = edge_of[min(node, parent) * (count + 1) + max(node, parent)]
        i, j = joined[edge]
        near, step = (i, steps[edge]) if j == node else (j, inverses[edge])
        x, y, angle = rows[near]
        cos, sin = math.cos(angle), math.sin(angle)
        rows[node] = [x + cos * step[0] - sin * step[1], y + sin * step[0] + cos * step[1], angle + step[2]]
    found = np.array(rows).reshape(count, 3)
    found[order[1:], 2] = se2.wrap_angle(found[order[1:], 2])
    return found


def best_first(information: Float, is_loop: NDArray[np.bool_], odometry_first: bool = False) -> Int:
    """The rows of the edges by the determinant of their information, shape (m, 3, 3), the greatest first.

    Among equally good edges, odometry comes before loops, then the earlier edge. With ``odometry_first``, odometry
    comes before loops whatever the determinants are.
    """
    determinants = -np.linalg.slogdet(information)[1]
    return np.lexsort((determinants, is_loop) if odometry_first else (is_loop, determinants))


def poses_along_edges(graph: PoseGraph, known: NDArray[np.bool_]) -> Float:
    """The poses, shape (n, 3), if only those of some nodes are ``known``, bool of shape (n,).

    The other nodes are placed along odometry edges where possible, and along loop edges only where no odometry leads to
    them, the best first. A part of the graph without a known pose begins at the origin, with its first fixed node, or
    otherwise its first node.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, (i, j) = len(graph), graph.edges.T
    links = coo_array((np.ones(len(i), np.int32), (i, j)), shape=(count, count))
    parts, part_of_node = connected_components(links, directed=False)
    has_root = np.zeros(parts, np.bool_)
    has_root[part_of_node[known]] = True
    roots, poses = known.copy(), np.where(known[:, None], graph.poses, 0.0)
    for node in (*graph.fixed, *range(count)):
        if not has_root[part_of_node[node]]:
            has_root[part_of_node[node]] = roots[node] = True
    preference = best_first(graph.information, graph.is_loop, odometry_first=True)
    return poses_along_tree(poses, roots, graph.edges, graph.measurements, preference)
