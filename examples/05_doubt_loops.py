"""Add false loops to a graph, and let a kernel find them: ... 05_doubt_loops.py GRAPH"""

import sys
from dataclasses import replace

import numpy as np

import mapmend


def with_false_loops(graph: mapmend.PoseGraph, count: int, seed: int) -> mapmend.PoseGraph:
    """The graph and, as its last edges, loops between nodes drawn at random that measure what never was."""
    random = np.random.default_rng(seed)
    first, last = random.integers(0, len(graph), (2, count))
    last = np.where(last == first, (first + 1) % len(graph), last)
    measurements = random.uniform((-5.0, -5.0, -np.pi), (5.0, 5.0, np.pi), (count, 3))
    information = np.tile(np.diag([100.0, 100.0, 1000.0]), (count, 1, 1))  # 0.1 m and 0.03 rad
    return replace(
        graph,
        edges=np.concatenate((graph.edges, np.stack((first, last), axis=1))),
        measurements=np.concatenate((graph.measurements, measurements)),
        information=np.concatenate((graph.information, information)),
        is_loop=np.concatenate((graph.is_loop, np.ones(count, np.bool_))),
    )


def main(path: str) -> None:
    graph = mapmend.read_graph(path)
    spoilt = with_false_loops(graph, count=10, seed=0)

    # False loops with full weight fold the map up, and a folded map stays folded: start along the odometry.
    for name in ("none", "gnc"):
        found = mapmend.optimize_from(spoilt, "odometry", kernel=mapmend.kernel_of(name))
        rows = mapmend.distrusted(found.result.edge_weights)
        print(f"{name}: distrusts {len(rows)} edges, {np.count_nonzero(rows >= len(graph.edges))} of the 10 false")


if __name__ == "__main__":
    main(sys.argv[1])
