"""Checks whether a graph can be optimized; each error is one line that names the node or the edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import Float, Int, PoseGraph

SYMMETRY_TOLERANCE = 1e-9


def check_numbers(graph: PoseGraph) -> None:
    """Raises ``MapmendError`` unless ids differ, numbers are finite, and information matrices positive definite."""
    if not (np.diff(graph.ids) > 0).all():  # most files have them in order
        ids, counts = np.unique(graph.ids, return_counts=True)
        if (counts > 1).any():
            raise MapmendError(f"two nodes of the graph are called {ids[np.argmax(counts > 1)]}")
    bad_nodes = ~_finite(graph.poses)
    if bad_nodes.any():
        raise MapmendError(f"the pose of node {graph.ids[np.argmax(bad_nodes)]} is not finite")
    _refuse_edges(graph, ~_finite(graph.measurements), "the measurement of", "is not finite")
    _refuse_edges(graph, ~_finite(graph.information), "the information of", "is not finite")
    _refuse_edges(graph, ~_symmetric(graph.information), "the information of", "is not symmetric")
    _refuse_edges(graph, ~positive_definite(graph.information), "the information of", "is not positive definite")


def check_weights(graph: PoseGraph, weights: Float) -> None:
    """Raises ``MapmendError`` unless ``weights`` has shape (m,) and is finite and not negative."""
    if weights.shape != (len(graph.edges),):
        raise MapmendError(f"weights must have shape ({len(graph.edges)},), got {weights.shape}")
    _refuse_edges(graph, ~(np.isfinite(weights) & (weights >= 0.0)), "the weight of", "is negative or not finite")


def check_connections(graph: PoseGraph) -> None:
    """Raises ``MapmendError`` where an edge joins a node to itself, or a node is not connected to a fixed one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, fixed = len(graph), np.asarray(graph.fixed, dtype=np.int64)
    if len(fixed) and (fixed.min() < 0 or fixed.max() >= n):
        raise MapmendError(f"a fixed node is outside 0..{n - 1}: {graph.fixed}")
    _refuse_edges(graph, graph.edges[:, 0] == graph.edges[:, 1], "", "joins a node to itself")
    if n and not len(fixed):
        raise MapmendError(f"no node is fixed, so the map may lie anywhere; fix one, such as node {graph.ids[0]}")
    links = coo_array((np.ones(len(graph.edges), np.int8), (graph.edges[:, 0], graph.edges[:, 1])), shape=(n, n))
    parts, part_of_node = connected_components(links, directed=False)
    held = np.zeros(parts, dtype=np.bool_)
    held[part_of_node[fixed]] = True
    loose = ~held[part_of_node]
    if loose.any():
        raise MapmendError(
            f"no chain of edges joins node {graph.ids[np.argmax(loose)]} to a fixed node "
            f"({int(loose.sum())} of {n} nodes are not connected to one); add an edge, or fix a node of that part"
        )


def _refuse_edges(graph: PoseGraph, bad: NDArray[np.bool_], before: str, after: str) -> None:
    """Names the first bad edge by the ids of its nodes, as they are in the file."""
    if bad.any():
        i, j = graph.edges[np.argmax(bad)]
        raise MapmendError(f"{before} edge {graph.ids[i]} -> {graph.ids[j]} {after}".strip())


def _finite(rows: Float) -> NDArray[np.bool_]:
    """Which rows hold finite numbers only, shape (rows,)."""
    if np.isfinite(rows).all():
        return np.ones(len(rows), dtype=np.bool_)
    return np.asarray(np.isfinite(rows).all(axis=tuple(range(1, rows.ndim))))


def _symmetric(matrices: Float) -> NDArray[np.bool_]:
    """Whether each of the (m, 3, 3) matrices is symmetric, up to the rounding of a file's decimals."""
    upper, lower = matrices[:, (0, 0, 1), (1, 2, 2)], matrices[:, (1, 2, 2), (0, 0, 1)]
    if np.array_equal(upper, lower):
        return np.ones(len(matrices), dtype=np.bool_)
    scale = np.abs(matrices).max(axis=(1, 2), initial=0.0)
    difference = np.abs(matrices - np.swapaxes(matrices, 1, 2)).max(axis=(1, 2), initial=0.0)
    return np.asarray(difference <= SYMMETRY_TOLERANCE * scale)


def positive_definite(matrices: Float) -> NDArray[np.bool_]:
    """Whether each of the (m, 3, 3) matrices has positive pivots, well above the rounding of their subtraction."""
    rounding = 8.0 * np.finfo(np.float64).eps
    a, b, c, d, e, f = np.ascontiguousarray(matrices.reshape(-1, 9)[:, (0, 3, 6, 4, 7, 8)].T)
    with np.errstate(all="ignore"):
        first = b / a
        second = d - b * first
        mixed = e - c * first
        third = f - c * c / a - mixed * mixed / second
        good = (a > 0.0) & (second > rounding * d) & (third > rounding * f)
    return np.asarray(good)


def same_pattern(graph: PoseGraph, edges: Int, fixed: tuple[int, ...], nodes: int) -> bool:
    """Whether the graph joins and fixes the same nodes in the same order."""
    return len(graph) == nodes and tuple(graph.fixed) == fixed and np.array_equal(graph.edges, edges)
