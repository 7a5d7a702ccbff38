"""Loops that confirm each other: this separates a few true loops from any number of false ones, before any descent.

A robot that comes back to a place stays near it for a while, so true loops come in groups: one of them predicts, along
a few steps of odometry, what the next must measure. False loops rarely agree with their neighbours, except where one
mistake is made again and again (false loops in groups). Latif, Cadena and Neira (RRR, IJRR 2013) cluster loops in time
and test each cluster; Mangelson et al. (PCM, ICRA 2018) test all pairs by the same cycle. Here only pairs that are near
each other are tested: over a few steps, odometry is certain enough for the test to mean something.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import Float, PoseGraph
from mapmend.graph.robust import TRUE_EDGE_CHI2

REACH_STEPS = 10.0
"""How far the ends of a loop may be from those of one that confirms it, in lengths of the graph's usual odometry step:
graphs have no common scale, and a robot that stands still makes nodes without going anywhere. On intel, M3500, ringCity
and Bicocca 25b with 1,000 random false loops, 92 to 100 % of the true ones are confirmed, and 0 to 2 % of the false
ones; with 20 steps 98 to 100 %, and up to 14 %."""


def confirmed_loops(graph: PoseGraph, information: Float, doubted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the ``doubted`` edges agree with another one, shape (m,), by ``information``, shape (m, 3, 3).

    If the other edges do not join each node to the next, no edge agrees: there is no chain along which to compare them.
    """
    from mapmend.graph import _agreement_kernels

    confirmed = np.zeros(len(graph.edges), dtype=np.bool_)
    rows = np.flatnonzero(doubted)
    chain = _chain(graph, information, ~doubted)
    if chain is None or len(rows) < 2:
        return confirmed
    ends, measured = graph.edges[rows], graph.measurements[rows].copy()
    covariances = np.linalg.inv(information[rows])
    back = ends[:, 0] > ends[:, 1]
    # A covariance is in the frame of the second node: turned round, it is carried to the other end.
    carry = se2.adjoint(measured[back])
    covariances[back] = carry @ covariances[back] @ np.swapaxes(carry, 1, 2)
    measured[back] = se2.inverse(measured[back])
    ends = np.sort(ends, axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    found = _agreement_kernels.confirmed(
        *chain, ends[order], measured[order], covariances[order], REACH_STEPS * usual_step_m(chain[1]), TRUE_EDGE_CHI2
    )
    confirmed[rows[order]] = found
    return confirmed


def usual_step_m(path_m: Float) -> float:
    """The median length of the steps of a chain that go anywhere; ``path_m`` (n,): its length up to each node."""
    steps = np.diff(path_m)
    moved = steps[steps > 0.0]
    return float(np.median(moved)) if len(moved) else 0.0


def _chain(graph: PoseGraph, information: Float, trusted: NDArray[np.bool_]) -> tuple[Float, Float, Float] | None:
    """The poses along the edges from each node to the next, shape (n, 3), the path length up to each node, (n,), and
    the covariance of the steps up to each node in the frame of the first, summed, shape (n, 3, 3); None where a step
    is missing."""
    count = len(graph)
    i, j = graph.edges.T
    step_of = np.full(count, -1)
    backward, forward = (np.flatnonzero(trusted & (a == b + 1))[::-1] for a, b in ((i, j), (j, i)))
    step_of[i[backward]] = backward
    step_of[j[forward]] = forward
    edges = step_of[1:]
    if (edges < 0).any():
        return None
    is_back = i[edges] > j[edges]
    steps = graph.measurements[edges].copy()
    steps[is_back] = se2.inverse(steps[is_back])
    poses = np.zeros((count, 3))
    poses[1:, 2] = np.cumsum(steps[:, 2])
    cos, sin = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    poses[1:, 0] = np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    poses[1:, 1] = np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    # The covariance of a measurement is in the frame of its second node.
    carry = se2.adjoint(poses[j[edges]])
    spread = np.zeros((count, 3, 3))
    spread[1:] = np.cumsum(carry @ np.linalg.inv(information[edges]) @ np.swapaxes(carry, 1, 2), axis=0)
    path_m = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
    return poses, path_m, spread
