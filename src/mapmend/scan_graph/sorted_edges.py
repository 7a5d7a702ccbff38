"""Sorting of the edges of a pose graph: which make up the chains of its nodes, and which are loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.scan_graph.chains import OdometryEdge, StretchEdge
from mapmend.scan_graph.loop_edges import LoopEdge

Float = NDArray[np.float64]


@dataclass(frozen=True)
class SortedEdges:
    """``odometry``: the edges between neighbouring nodes, by their last node. ``stretches``: further odometry edges,
    over several nodes or beside another edge. ``loops``: all others. Every edge leads from a node to a later one."""

    odometry: dict[int, OdometryEdge]
    stretches: list[StretchEdge]
    loops: list[LoopEdge]


def sort_edges(graph: PoseGraph) -> SortedEdges:
    """Sorts the edges of a graph, by ``is_loop`` and by the rows of their nodes.

    An odometry edge between nodes without a chain of odometry edges between them counts as a loop edge.
    """
    found = SortedEdges({}, [], [])
    forward = [_forward(graph, row) for row in range(len(graph.edges))]
    is_chain = ~graph.is_loop & (np.abs(np.diff(graph.edges, axis=1)[:, 0]) == 1)
    further: list[int] = []
    for row in np.flatnonzero(is_chain).tolist():
        _, last, measured, information = forward[row]
        if last in found.odometry:
            further.append(row)
        else:
            covariance = se2.invert_symmetric(information)
            found.odometry[last] = OdometryEdge(measured, covariance, covariance)
    for row in sorted([*further, *np.flatnonzero(~is_chain).tolist()]):
        first, last, measured, information = forward[row]
        if not graph.is_loop[row] and all(j in found.odometry for j in range(first + 1, last + 1)):
            found.stretches.append(StretchEdge(first, last, measured, information))
        else:
            found.loops.append(LoopEdge(first, last, measured, information))
    return found


def _forward(graph: PoseGraph, row: int) -> tuple[int, int, Float, Float]:
    """An edge from the earlier of its nodes to the later one: nodes, measurement (3,), information (3, 3)."""
    i, j = graph.edges[row].tolist()
    measured, information = graph.measurements[row], graph.information[row]
    if i < j:
        return i, j, measured.copy(), information.copy()
    # The inverse of T_j_i * d is T_i_j with a perturbation at i: the adjoint carries d from j to i.
    carry = se2.adjoint(se2.inverse(measured))
    turned = carry.T @ information @ carry
    return j, i, se2.inverse(measured), 0.5 * (turned + turned.T)
