"""Run by an interpreter that has g2o-python, which needs CPython 3.11 and NumPy 1: its seconds for a graph, as JSON.

    python _g2o_child.py GRAPH.g2o ITERATIONS RUNS SOLVER

"solve" is ``optimize`` alone; "whole" goes from numbers in memory to poses in memory, through the building of g2o's
vertices and edges one by one, since the binding reads no files.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import g2o  # type: ignore[import-not-found]
import numpy as np

Rows = list[list[float]]


def read(path: str) -> tuple[Rows, Rows]:
    """The numbers of VERTEX_SE2 and EDGE_SE2 lines."""
    words = [line.split() for line in Path(path).read_text().splitlines()]
    rows = [[[float(word) for word in line[1:]] for line in words if line[:1] == [kind]] for kind in KINDS]
    return rows[0], rows[1]


KINDS = ("VERTEX_SE2", "EDGE_SE2")


def build(vertices: Rows, edges: Rows, solver: str) -> g2o.SparseOptimizer:
    """A Gauss-Newton optimizer of the graph, its first vertex fixed."""
    optimizer = g2o.SparseOptimizer()
    block_solver = g2o.BlockSolverSE2(getattr(g2o, solver)())
    optimizer.set_algorithm(g2o.OptimizationAlgorithmGaussNewton(block_solver))
    for number, *pose in vertices:
        vertex = g2o.VertexSE2()
        vertex.set_id(int(number))
        vertex.set_estimate(g2o.SE2(*pose))
        vertex.set_fixed(number == vertices[0][0])
        optimizer.add_vertex(vertex)
    for i, j, x, y, angle, xx, xy, xa, yy, ya, aa in edges:
        edge = g2o.EdgeSE2()
        edge.set_vertex(0, optimizer.vertex(int(i)))
        edge.set_vertex(1, optimizer.vertex(int(j)))
        edge.set_measurement(g2o.SE2(x, y, angle))
        edge.set_information(np.array([[xx, xy, xa], [xy, yy, ya], [xa, ya, aa]]))
        optimizer.add_edge(edge)
    return optimizer


def main() -> None:
    path, iterations, runs, solver = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    vertices, edges = read(path)
    solve_s, whole_s = [], []
    chi2 = float("nan")
    for _ in range(runs):
        began = time.perf_counter()
        optimizer = build(vertices, edges, solver)
        optimizer.initialize_optimization()
        before = time.perf_counter()
        optimizer.optimize(iterations)
        solve_s.append(time.perf_counter() - before)
        poses = [optimizer.vertex(int(row[0])).estimate().to_vector() for row in vertices]
        whole_s.append(time.perf_counter() - began)
        assert len(poses) == len(vertices)
        optimizer.compute_active_errors()
        chi2 = optimizer.active_chi2()
    print(json.dumps({"solve": solve_s, "whole": whole_s, "chi2": chi2}))


if __name__ == "__main__":
    main()
