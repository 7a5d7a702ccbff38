"""The back end beside GTSAM 4.3 and g2o: seconds to solve public graphs and generated grid worlds, in one run.

Ours runs with one thread for each core (``--threads``), which only the grid worlds are large enough for; GTSAM and g2o
run as their wheels were built. All take the same number of Gauss-Newton steps from the same poses: as many as mapmend
needs by its own rule, at most ten. "solve" is all from the first linearization to the last update, with the ordering.
"call" is mapmend's whole `optimize`, with its checks of the graph, which the others do not make. "whole" is from a file
to poses in memory, by each library's own reader; g2o-python has none, and its "whole" begins with numbers in memory.
"again" is mapmend's second solve of a graph with other weights, over the first. The first is all of `optimize` from the
given poses: checks, order, symbolic analysis, and steps until it converges by its defaults. The second is all of
`optimize` with the first's system from the first's optimum, loops weighed at random between a half and one, until it
converges. "marginals" are those of all nodes.

A second table has the parts of the time: the analysis, once, and a step's linearization, factorization and solution;
beside them the lower bounds: the multiply-adds of the factorization over the greatest rate of one core measured here
(``--peak``), and the bytes of H and L, each read once, over the memory's speed (``--memory``).

g2o-python 0.0.12 has a wheel for CPython 3.11 only and needs NumPy 1, so it needs an environment of its own:

    python3.11 -m venv g2o-env
    g2o-env/bin/pip install g2o-python==0.0.12 'numpy<2'
    python benchmarks/backend_speed.py --g2o-python g2o-env/bin/python

Without it its columns stay empty. LinearSolverEigenSE2 is the fastest of its solvers: LinearSolverPCGSE2 took twice
as long on M3500 and 70 times as long on bicocca25b_0.000 (``--g2o-solver``), the dense one squares the nodes.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import gtsam
import numpy as np
from _measure import data_parser, markdown, run, stop
from grid_world import grid_world

from mapmend.graph.elimination import analyse
from mapmend.graph.marginals import marginals
from mapmend.graph.optimizer import OptimizerSettings, optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.starts import starting_poses
from mapmend.graph.system import Factorization, System
from mapmend.io.g2o import read_g2o, write_g2o
from mapmend.io.graph_lines import parse_graph
from mapmend.io.reader import read_bytes

PUBLIC = (
    "posegraphs/intel.g2o.gz",
    "posegraphs/M3500.g2o.gz",
    "posegraphs/M3500a.g2o.gz",
    "posegraphs/ringCity.g2o.gz",
    "posegraphs/bicocca25b_0.000.g2o.gz",
    "posegraphs/bicocca25b_0.200.g2o.gz",
    "posegraphs/bicocca25b_0.500.g2o.gz",
    "scangraphs/intel.toro.gz",
    "scangraphs/fr079.toro.gz",
    "scangraphs/killian.g2o.gz",
)
GENERATED = {"grid 10,000": (10_000, 64_000), "grid 100,000": (100_000, 220_000)}
CHORDAL = ("posegraphs/M3500a.g2o.gz",)  # from its given poses every Gauss-Newton diverges
PARTS_HEAD = (
    "graph",
    "analysis [ms]",
    "a step: linearization",
    "factor",
    "solution",
    "multiply-adds of the factor [M]",
    "H and L [MB]",
    "floor by multiply-adds [ms]",
    "floor by bytes [ms]",
)
MOST_STEPS = 10
MOST_NODES_FOR_MARGINALS = 9_000
HEAD = (
    "graph",
    "nodes",
    "edges",
    "steps",
    "solve [ms]",
    "GTSAM",
    "g2o",
    "GTSAM / ours",
    "g2o / ours",
    "call [ms]",
    "whole [ms]",
    "GTSAM",
    "g2o",
    "again",
    "steps, factors",
    "marginals [ms]",
    "GTSAM",
    "chi2",
    "GTSAM",
    "g2o",
)


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument(
        "--graphs", nargs="+", metavar="NAME", help="those whose names hold one of these (default: all)"
    )
    parser.add_argument("--runs", type=int, default=9, metavar="N", help="runs after a warm-up (default: 9)")
    parser.add_argument(
        "--g2o-python",
        default=os.environ.get("MAPMEND_G2O_PYTHON"),
        metavar="PATH",
        help="an interpreter with g2o-python (default: what MAPMEND_G2O_PYTHON names)",
    )
    parser.add_argument("--g2o-solver", default="LinearSolverEigenSE2", metavar="NAME", help="its solver of H x = b")
    parser.add_argument(
        "--threads", type=int, default=os.cpu_count() or 1, metavar="N", help="of ours, which large graphs use"
    )
    parser.add_argument("--peak", type=float, default=21.0, metavar="G", help="multiply-adds a second of one core")
    parser.add_argument("--memory", type=float, default=10.0, metavar="G", help="bytes a second from and to memory")
    options = parser.parse_args()
    if not options.data:
        stop("name the folder with posegraphs/ and scangraphs/, or set MAPMEND_DATA")
    names = [n for n in (*PUBLIC, *GENERATED) if not options.graphs or any(part in n for part in options.graphs)]
    if not options.g2o_python:
        print("g2o is left out: name an interpreter that has it (--g2o-python; --help says how to make one)\n")
    parts: list[tuple[str, ...]] = []
    print(markdown(HEAD, []), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            print(f"| {' | '.join(row(name, Path(folder) / 'graph.g2o', options))} |", flush=True)
            parts.append(parts_row(name, options))
    print("\n" + markdown(PARTS_HEAD, parts))


def row(name: str, file: Path, options: argparse.Namespace) -> tuple[str, ...]:
    """One graph's line; ``file`` is where all three read it."""
    write_g2o(file, load(name, options.data))
    lines = file.read_text().splitlines(keepends=True)
    # All three read the same lines: poses and edges.
    file.write_text("".join(line for line in lines if line.startswith(("VERTEX_SE2", "EDGE_SE2"))))
    graph = read_g2o(file)
    steps = min(MOST_STEPS, max(1, optimize(graph, OptimizerSettings("gauss-newton", MOST_STEPS)).iterations))
    settings = OptimizerSettings("gauss-newton", steps, 0.0, 0.0)
    rounds = [one_round(file, graph, settings, options.threads) for _ in range(options.runs + 1)][1:]
    middle = {key: statistics.median(r[key] for r in rounds) for key in rounds[0] if key != "told"}
    # One library's solves after another's would find the caches full of the other's numbers; g2o's have a process to
    # themselves.
    calls = [one_call(graph, settings, options.threads) for _ in range(options.runs + 1)][1:]
    gtsam_solves = [solve_with_gtsam(file, steps)[0] for _ in range(options.runs + 1)][1:]
    middle["gtsam_solve"] = statistics.median(gtsam_solves)
    middle["call"], middle["solve"] = (statistics.median(column) for column in zip(*calls, strict=True))
    theirs: dict[str, Any] = {}
    if options.g2o_python:
        child = str(Path(__file__).with_name("_g2o_child.py"))
        told = run([options.g2o_python, child, str(file), str(steps), str(options.runs), options.g2o_solver])
        theirs = json.loads(told.output)
    g2o_solve, g2o_whole = (statistics.median(theirs[key]) if theirs else float("nan") for key in ("solve", "whole"))
    numbers = (
        middle["solve"] * 1e3,
        middle["gtsam_solve"] * 1e3,
        g2o_solve * 1e3,
        middle["gtsam_solve"] / middle["solve"],
        g2o_solve / middle["solve"],
        middle["call"] * 1e3,
        middle["whole"] * 1e3,
        middle["gtsam_whole"] * 1e3,
        g2o_whole * 1e3,
        middle["again"],
        middle["marginals"] * 1e3,
        middle["gtsam_marginals"] * 1e3,
    )
    chi2 = (middle["chi2"], middle["gtsam_chi2"], theirs.get("chi2", float("nan")))
    cells = [f"{number:.2f}" if np.isfinite(number) else "" for number in numbers]
    cells.insert(10, rounds[0]["told"])
    cells += [f"{number:.4f}" if np.isfinite(number) else "" for number in chi2]
    return (name, f"{len(graph):,}", f"{len(graph.edges):,}", str(steps), *cells)


def parts_row(name: str, options: argparse.Namespace) -> tuple[str, ...]:
    """What a solve of the graph is made of: the least milliseconds of each part, and the floors."""
    graph = load(name, options.data)
    system = System(graph, options.threads)
    elimination, fronts = system.elimination, system.elimination.fronts
    spare = system.linearize(graph.poses, graph.measurements, graph.information)
    ends, count = system.unknowns[system.edges], len(system.nodes)
    work: tuple[Callable[[], Any], ...] = (
        lambda: analyse(ends, count, options.threads),
        lambda: system.linearize(graph.poses, graph.measurements, graph.information, spare),
        lambda: system.solve(spare.values, spare.gradient),
        lambda: system.solve_again(spare.gradient),
    )
    analysis, linearization, both, solution = (min(timed(one)[0] for _ in range(options.runs)) * 1e3 for one in work)
    widths, rows = (np.diff(one.view(np.int64)) for one in (fronts.firsts, fronts.row_starts))
    own, below = 3.0 * widths.astype(np.float64), 3.0 * rows.astype(np.float64)
    products = float(((own + below) ** 3 - below**3).sum() / 6.0)
    megabytes = 8e-6 * (elimination.lower_size + len(spare.values))
    floors = (products / options.peak * 1e-6, megabytes / options.memory)
    numbers = (analysis, linearization, both - solution, solution, products * 1e-6, megabytes, *floors)
    return (name, *(f"{number:.2f}" for number in numbers))


def load(name: str, data: str) -> PoseGraph:
    """The graph with the poses that all start from."""
    if name in GENERATED:
        return grid_world(*GENERATED[name])
    path = Path(data) / name
    if not path.is_file():
        stop(f"no {path}; name the folder with posegraphs/ and scangraphs/, or set MAPMEND_DATA")
    graph = parse_graph(read_bytes(path), str(path))
    return graph.with_poses(starting_poses(graph, "chordal")) if name in CHORDAL else graph


def one_round(file: Path, graph: PoseGraph, settings: OptimizerSettings, threads: int) -> dict[str, Any]:
    """Seconds of a whole call, and chi2, of mapmend and of GTSAM, one after the other."""
    whole_s, result = timed(lambda: optimize(read_g2o(file), settings, threads=threads))
    weights = np.where(graph.is_loop, np.random.default_rng(0).uniform(0.5, 1.0, len(graph.edges)), 1.0)
    first, again, told = first_and_again(graph, weights, threads)
    marginals_s, gtsam_marginals_s = float("nan"), float("nan")
    small = len(graph) <= MOST_NODES_FOR_MARGINALS
    if small:
        factorization = result.factorization
        marginals_s, _ = timed(lambda: marginals(factorization))
    gtsam_whole_s, (_, factors, values) = timed(lambda: solve_with_gtsam(file, settings.max_iterations))
    if small:
        gtsam_marginals_s, _ = timed(lambda: gtsam_marginals(factors, values))
    return {
        "whole": whole_s,
        "chi2": result.chi2_final,
        "again": again / first,
        "told": told,
        "marginals": marginals_s,
        "gtsam_whole": gtsam_whole_s,
        "gtsam_chi2": 2.0 * factors.error(values),
        "gtsam_marginals": gtsam_marginals_s,
    }


def one_call(graph: PoseGraph, settings: OptimizerSettings, threads: int) -> tuple[float, float]:
    """Seconds of `optimize`, and of its solving alone; nothing but that happens between two calls, as with g2o."""
    began = time.perf_counter()
    result = optimize(graph, settings, threads=threads)
    return time.perf_counter() - began, result.seconds["solve"]


def first_and_again(graph: PoseGraph, weights: np.ndarray[Any, Any], threads: int) -> tuple[float, float, str]:
    """Seconds of a first call and of one with other weights that begins where the first ended, both until they
    converge; and how many steps and factorizations each took."""
    made: list[int] = []
    factorize = System._factorize

    def counted(self: System, *arguments: Any) -> Factorization:
        made.append(1)
        return factorize(self, *arguments)

    first_s, first = timed(lambda: optimize(graph, threads=threads))
    solved = graph.with_poses(first.poses)
    again_s, again = timed(lambda: optimize(solved, weights=weights, system=first.system))
    told = []
    with mock.patch.object(System, "_factorize", counted):
        for one, system in ((graph, None), (solved, first.system)):
            made.clear()
            result = optimize(one, weights=None if system is None else weights, system=system)
            told.append(f"{result.iterations}, {len(made)}{'' if result.converged else ' not converged'}")
    assert again.iterations
    return first_s, again_s, "; ".join(told)


def solve_with_gtsam(file: Path, steps: int) -> tuple[float, Any, Any]:
    """Its seconds for ordering and that many steps, its factors, and where it ended."""
    factors, start = gtsam.readG2o(str(file), False)
    first = min(start.keys())
    factors.add(gtsam.PriorFactorPose2(first, start.atPose2(first), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    began = time.perf_counter()
    optimizer = gtsam.GaussNewtonOptimizer(factors, start, gtsam.GaussNewtonParams())
    for _ in range(steps):
        optimizer.iterate()
    solve_s = time.perf_counter() - began
    values = optimizer.values()
    gtsam.utilities.extractPose2(values)
    return solve_s, factors, values


def gtsam_marginals(factors: Any, values: Any) -> list[Any]:
    found = gtsam.Marginals(factors, values)
    keys = values.keys()
    return [found.marginalCovariance(key) for key in keys]


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds, and the result; the garbage collector is off meanwhile."""
    gc.collect()
    gc.disable()
    began = time.perf_counter()
    result = work()
    seconds = time.perf_counter() - began
    gc.enable()
    return seconds, result


if __name__ == "__main__":
    main()
