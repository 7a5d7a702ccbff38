"""Graphs that benchmarks/papers.py shows: a bent map (MC Figure 1) and one with false loops (MC Figure 4)."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.g2o import write_g2o
from mapmend.io.reader import read
from mapmend.lab.false_loops import add_false_loops
from mapmend.lab.map_corruption import corrupt, graph_of_log
from mapmend.scan import ScanLog

KIND, COUNT, SEED = "local", 50, 0
BENT, BENT_SEED = "rotated wing", 1


def main() -> None:
    data, place = Path(os.environ["MAPMEND_DATA"]), Path(sys.argv[1])
    log = read(data / "keyscans" / "belgioioso.clf.gz")
    assert isinstance(log, ScanLog)
    write_g2o(place / "belgioioso-bent.g2o", corrupt(graph_of_log(log), BENT, BENT_SEED).graph)
    graph = read(data / "scangraphs" / "intel.toro.gz")
    assert isinstance(graph, PoseGraph)
    write_g2o(place / "intel-false.g2o", add_false_loops(graph, KIND, COUNT, SEED).graph)
    print(f"intel.toro.gz with {COUNT} false loops of kind {KIND}; belgioioso.clf.gz, corruption {BENT}")


if __name__ == "__main__":
    main()
