"""The plain twin of the agreement kernel: every pair of loops, one at a time, covariances step by step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph

Array = NDArray[np.float64]


def carried(pose: Array, covariance: Array) -> Array:
    adjoint = se2.adjoint(pose)
    return adjoint @ covariance @ adjoint.T


def seen_from_first(measurement: Array, covariance: Array, forward: bool) -> tuple[Array, Array]:
    """The later node seen from the earlier one, and its covariance in its own frame."""
    if forward:
        return measurement, covariance
    return se2.inverse(measurement), carried(measurement, covariance)


def along(graph: PoseGraph, a: int, b: int) -> tuple[Array, Array]:
    """``T_a_b`` by the odometry, step by step, and its covariance in the frame of b."""
    pose, covariance = np.zeros(3), np.zeros((3, 3))
    for k in range(min(a, b), max(a, b)):
        for row in np.flatnonzero(~graph.is_loop):
            if set(graph.edges[row].tolist()) == {k, k + 1}:
                inverse = np.linalg.inv(graph.information[row])
                step, spread = seen_from_first(graph.measurements[row], inverse, graph.edges[row, 0] == k)
                break
        pose = se2.compose(pose, step)
        covariance = carried(se2.inverse(step), covariance) + spread
    return (pose, covariance) if a <= b else (se2.inverse(pose), carried(pose, covariance))


def disagreement(graph: PoseGraph, p: int, q: int) -> float:
    """How far loop q is from what loop p foretells, squared, in standard deviations of both and of the odometry."""
    ends, poses, covariances = [], [], []
    for row in (p, q):
        i, j = graph.edges[row].tolist()
        inverse = np.linalg.inv(graph.information[row])
        pose, covariance = seen_from_first(graph.measurements[row], inverse, i < j)
        ends.append((min(i, j), max(i, j)))
        poses.append(pose)
        covariances.append(covariance)
    (i, j), (k, m) = ends
    pose, covariance = along(graph, k, i)
    for step, spread in ((poses[0], covariances[0]), along(graph, j, m)):
        pose = se2.compose(pose, step)
        covariance = carried(se2.inverse(step), covariance) + spread
    error = se2.between(poses[1], pose)
    return float(error @ np.linalg.solve(covariance + covariances[1], error))


def confirmed(graph: PoseGraph, reach_steps: float, bound: float) -> NDArray[np.bool_]:
    """Which loops agree with another one nearby, shape (m,)."""
    found = np.zeros(len(graph.edges), dtype=np.bool_)
    loops = np.flatnonzero(graph.is_loop)
    ends = np.sort(graph.edges, axis=1)
    steps_m = [float(np.hypot(*along(graph, k, k + 1)[0][:2])) for k in range(len(graph) - 1)]
    path_m = np.concatenate(([0.0], np.cumsum(steps_m)))
    reach_m = reach_steps * float(np.median([step for step in steps_m if step > 0.0]))
    for a, p in enumerate(loops):
        for q in loops[a + 1 :]:
            apart = np.abs(path_m[ends[p]] - path_m[ends[q]])
            # The one whose first node comes first foretells the other.
            one, other = (p, q) if ends[p].tolist() <= ends[q].tolist() else (q, p)
            if (
                ends[p].tolist() != ends[q].tolist()
                and apart.max() <= reach_m
                and disagreement(graph, one, other) <= bound
            ):
                found[[p, q]] = True
    return found
