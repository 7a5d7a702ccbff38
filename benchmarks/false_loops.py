"""How much do false loop edges harm `igo` if they are added before the iteration? By count and seed, on a recording.

The front end maps the log once. Then, for every count and seed, false loops (`lab/false_loops.py`, between nodes
drawn at random, with the information of true ones) are put into its graph, and the iteration starts.
"""

from __future__ import annotations

import copy

import numpy as np
from _measure import data_parser, log_path, markdown, relations_path

from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.igo.iterate import iterate
from mapmend.io.read_log import read_log
from mapmend.io.relations import Relations, read_relations
from mapmend.lab.false_loops import FALSE_LOOP_KINDS, add_false_loops
from mapmend.scan_graph.loop_edges import LoopEdge
from mapmend.scan_graph.scan_graph import ScanGraph

COUNTS = (1, 5, 20)
HEAD = ("false loops", "kind", "seeds", "median [m]", "worst [m]", "in seed", "over clean", "left of the false ones")


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--log", default="intel", help="the recording (default: intel)")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="seeds a count (default: 10)")
    parser.add_argument("--kinds", nargs="+", default=FALSE_LOOP_KINDS, choices=FALSE_LOOP_KINDS, help="default: all")
    options = parser.parse_args()
    log = read_log(log_path(options.data, options.log))
    mapped = FrontEnd(log.scans.geometries, Config()).run(log)
    relations = read_relations(relations_path(options.data, options.log))
    clean, _ = spoiled(mapped, relations, options.kinds[0], 0, 0)
    rows = [("0", "", "1", f"{clean:.4f}", f"{clean:.4f}", "0", "1.00", "")]
    for kind in options.kinds:
        for count in COUNTS:
            measured = [spoiled(mapped, relations, kind, count, seed) for seed in range(options.seeds)]
            errors = np.array([error for error, _ in measured])
            worst = int(np.argmax(errors))
            left = sum(far for _, far in measured)
            cells = (f"{np.median(errors):.4f}", f"{errors[worst]:.4f}", str(worst), f"{errors[worst] / clean:.2f}")
            rows.append((str(count), kind, str(len(errors)), *cells, f"{left} of {count * len(errors)}"))
    print(markdown(HEAD, rows))


def spoiled(graph_of_log: ScanGraph, relations: Relations, kind: str, count: int, seed: int) -> tuple[float, int]:
    """The error over relations after the iteration, and how many of the false loops are still what they were."""
    mapped = copy.deepcopy(graph_of_log)
    corrupted = add_false_loops(mapped.pose_graph(), kind, count, seed)
    graph = corrupted.graph
    false = [
        LoopEdge(int(graph.edges[row, 0]), int(graph.edges[row, 1]), graph.measurements[row], graph.information[row])
        for row in np.flatnonzero(corrupted.is_false)
    ]
    mapped.loops += false
    iterate(mapped)
    poses, stamps = mapped.scan_poses(), mapped.hung.stamps_s
    errors = relation_errors(stamps, poses, relations.t1_s, relations.t2_s, relations.relative_poses)
    kept = {id(edge) for edge in mapped.loops}
    return errors.translation_mean_m, sum(id(edge) in kept for edge in false)


if __name__ == "__main__":
    main()
