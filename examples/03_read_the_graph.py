"""Read the graph of a RUN, optimize it again, and print the uncertainty of its nodes: ... 03_read_the_graph.py RUN"""

import sys

import numpy as np

import mapmend


def main(run_folder: str) -> None:
    graph = mapmend.read_graph(run_folder)
    print(f"{len(graph)} nodes, {len(graph.edges)} edges, {np.count_nonzero(graph.is_loop)} of them loops")

    result = mapmend.optimize(graph)
    print(f"chi2 {result.chi2_initial:.2f} as read, {result.chi2_final:.2f} after {result.iterations} steps")

    # For every node, relative to the fixed one: x ahead, y to the left of the robot, both in metres, and the heading.
    covariances = mapmend.marginals(result.factorization)
    worst = int(np.argmax(np.trace(covariances[:, :2, :2], axis1=1, axis2=2)))
    ahead, left, heading = np.sqrt(np.diag(covariances[worst]))
    print(f"least certain is node {graph.ids[worst]}: {ahead:.3f} m ahead, {left:.3f} m to the left,", end=" ")
    print(f"{np.degrees(heading):.2f} deg")


if __name__ == "__main__":
    main(sys.argv[1])
