"""A seeded world of streets: a pose graph of any size, in the manner of Manhattan and City 10000.

    python benchmarks/grid_world.py NODES EDGES OUT.g2o [--seed N]

A robot drives block after block through a square town, turning at some crossings, and turns back at the town's edge.
Besides its odometry it measures nodes of earlier passes that are at most a crossing away, chosen at random among all
such pairs. The poses given are those of the truth, each with an error of some decimetres and degrees: a start in the
valley of the optimum, so that the benchmark times the solver and not the luck of the descent.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapmend.graph.pose_graph import PoseGraph

BLOCK_M = 2.0
VISITS = 2  # how often the robot comes to a crossing, on average
TURN_SHARE = 0.3
MEASURED_STD = (0.05, 0.05, 0.02)
START_STD = (0.3, 0.3, 0.1)


def grid_world(nodes: int, edges: int, seed: int = 0) -> PoseGraph:
    """The graph; raises ``ValueError`` where there are fewer pairs of neighbours than edges wanted."""
    import numpy as np

    from mapmend.geometry import se2
    from mapmend.graph.pose_graph import PoseGraph

    generator = np.random.default_rng(seed)
    side = int(np.sqrt(nodes / VISITS)) + 1
    heading, crossing = 0, np.array([side // 2, side // 2])
    ways = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    turns = np.where(generator.random(nodes) < TURN_SHARE, generator.choice([1, 3], size=nodes), 0)
    crossings, headings = np.zeros((nodes, 2), dtype=np.int64), np.zeros(nodes, dtype=np.int64)
    for k in range(nodes):
        crossings[k], headings[k] = crossing, heading
        heading = (heading + turns[k]) % 4
        while not np.all((crossing + ways[heading] >= 0) & (crossing + ways[heading] < side)):
            heading = (heading + 1) % 4
        crossing = crossing + ways[heading]
    truth = np.column_stack((BLOCK_M * crossings, se2.wrap_angle(headings * np.pi / 2.0)))

    here: dict[tuple[int, int], list[int]] = {}
    pairs = []
    for k, (x, y) in enumerate(crossings.tolist()):
        for cell in ((x, y), (x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)):
            pairs += [(other, k) for other in here.get(cell, ()) if other < k - 1]
        here.setdefault((x, y), []).append(k)
    loops = edges - (nodes - 1)
    if loops > len(pairs):
        raise ValueError(f"{len(pairs)} pairs of neighbours can't give {loops} loops")
    chosen = np.sort(generator.choice(len(pairs), size=loops, replace=False))
    odometry = np.stack((np.arange(nodes - 1), np.arange(1, nodes)), axis=1)
    joined = np.concatenate((odometry, np.array(pairs, dtype=np.int64)[chosen]))
    measured = se2.between(truth[joined[:, 0]], truth[joined[:, 1]])
    measurements = se2.compose(measured, generator.normal(scale=MEASURED_STD, size=measured.shape))
    information = np.broadcast_to(np.diag(1.0 / np.square(MEASURED_STD)), (edges, 3, 3)).copy()
    start = se2.compose(truth, generator.normal(scale=START_STD, size=truth.shape))
    start[0] = truth[0]
    return PoseGraph(start, np.arange(nodes), joined, measurements, information, np.arange(edges) >= nodes - 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nodes", type=int, metavar="NODES")
    parser.add_argument("edges", type=int, metavar="EDGES")
    parser.add_argument("output", metavar="OUT.g2o")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    options = parser.parse_args()
    from mapmend.io.g2o import write_g2o

    write_g2o(options.output, grid_world(options.nodes, options.edges, options.seed))


if __name__ == "__main__":
    main()
