"""Add false loops to a graph, and let a kernel find them: ... 05_doubt_loops.py GRAPH"""

import sys

import numpy as np

from mapmend.graph.optimizer import optimize
from mapmend.graph.robust import distrusted, kernel_of
from mapmend.graph.starts import along_odometry
from mapmend.io.g2o import read_g2o
from mapmend.lab.false_loops import add_false_loops


def main(path: str) -> None:
    graph = read_g2o(path)
    corrupted = add_false_loops(graph, "random", count=10, seed=0)
    spoilt, is_false = corrupted.graph, corrupted.is_false

    # False loops with full weight fold the map up, and a folded map stays folded: start along the odometry.
    start = spoilt.with_poses(along_odometry(spoilt))
    for name in ("none", "gnc"):
        result = optimize(start, kernel=kernel_of(name))
        rows = distrusted(result.edge_weights)
        print(f"{name}: distrusts {len(rows)} edges, {np.count_nonzero(is_false[rows])} of the {is_false.sum()} false")


if __name__ == "__main__":
    main(sys.argv[1])
