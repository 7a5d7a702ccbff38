"""Graphs spoiled on demand: false loop edges, as the robust-SLAM literature adds them to public graphs.

The four kinds are those of Suenderhauf and Protzel (IROS 2012; their generator in the Vertigo suite), which Latif et
al. (RRR) and others took over. A false loop claims, as place recognition does, that the robot is back where it was: its
measurement is near zero whatever the poses, with a spread of 0.3 m an axis and 10 degrees.

- ``random``: between any two nodes.
- ``local``: between a node and one of the next 20, as when a robot confuses places that it has just seen.
- ``random-groups``, ``local-groups``: the same in runs of 10 (as in Suenderhauf's thesis): the loops of a run join
  consecutive nodes to consecutive nodes by one and the same measurement, so that they confirm each other, as similar
  rooms do.

A pair is drawn without looking at the poses: some of the false loops of a long drive are true by chance. ``count`` is
that of the edges, also in groups; the last group may be shorter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import Float, Int, PoseGraph

FALSE_LOOP_KINDS = ("random", "local", "random-groups", "local-groups")

LOCAL_NODES = 20
GROUP_SIZE = 10
POSITION_STD_M = 0.3
ANGLE_STD_RAD = float(np.radians(10.0))
NEAREST_NODES = 2
"""A false loop reaches at least the second node from its first: edges between neighbours are odometry."""


@dataclass(frozen=True)
class CorruptedGraph:
    """``graph``: the given edges in their order, then the false ones. ``is_false``: shape (m,), true for the false
    ones."""

    graph: PoseGraph
    is_false: NDArray[np.bool_]


def add_false_loops(graph: PoseGraph, kind: str, count: int, seed: int) -> CorruptedGraph:
    """The graph with ``count`` more loop edges, all false, each with the information of one of its own loops.

    The same arguments give the same graph. In a graph without loops, the odometry edges provide the information. Raises
    ``MapmendError`` for an unknown kind, a negative count, and a graph without edges or of too few nodes.
    """
    if kind not in FALSE_LOOP_KINDS:
        raise MapmendError(f"false loops must be one of {', '.join(FALSE_LOOP_KINDS)}, got {kind!r}")
    if count < 0:
        raise MapmendError(f"the number of false loops must not be negative, got {count}")
    size = GROUP_SIZE if kind.endswith("groups") else 1
    free = len(graph) - NEAREST_NODES - (size - 1)
    if free < 1 or not len(graph.edges):
        raise MapmendError(f"no room for {kind} loops in a graph of {len(graph)} nodes and {len(graph.edges)} edges")
    generator = np.random.default_rng(seed)
    groups = -(-count // size)
    first = _pairs(generator, groups, free, is_local=kind.startswith("local"))
    spread = np.array([POSITION_STD_M, POSITION_STD_M, ANGLE_STD_RAD])
    measured = spread * generator.normal(size=(groups, 3))
    lenders = np.flatnonzero(graph.is_loop if graph.is_loop.any() else ~graph.is_loop)
    lent = generator.choice(lenders, size=groups)

    group, place = np.divmod(np.arange(count), size)
    return _with_edges(graph, first[group] + place[:, None], measured[group], graph.information[lent[group]])


def _pairs(generator: np.random.Generator, count: int, free: int, is_local: bool) -> Int:
    """The first pair of nodes of each group, shape (count, 2), the earlier node first; ``free``: the range of both."""
    if is_local:
        earlier = generator.integers(0, free, size=count)
        reach = np.minimum(LOCAL_NODES, NEAREST_NODES + free - 1 - earlier)
        return np.stack((earlier, earlier + generator.integers(NEAREST_NODES, reach + 1)), axis=1)
    # Two different ones of free + 1 places; the later one is moved on so that the two are not neighbours.
    one = generator.integers(0, free + 1, size=count)
    other = (one + generator.integers(1, free + 1, size=count)) % (free + 1)
    return np.stack((np.minimum(one, other), np.maximum(one, other) + NEAREST_NODES - 1), axis=1)


def _with_edges(graph: PoseGraph, edges: Int, measurements: Float, information: Float) -> CorruptedGraph:
    """The graph with more loop edges after its own."""
    more = np.ones(len(edges), dtype=np.bool_)
    corrupted = replace(
        graph,
        edges=np.concatenate((graph.edges, edges)),
        measurements=np.concatenate((graph.measurements, measurements)),
        information=np.concatenate((graph.information, information)),
        is_loop=np.concatenate((graph.is_loop, more)),
    )
    return CorruptedGraph(corrupted, np.concatenate((np.zeros(len(graph.edges), dtype=np.bool_), more)))
