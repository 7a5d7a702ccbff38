"""How much error false loops cause, by kernel: the absolute trajectory error, ours beside GTSAM's.

ringCity and Bicocca 25b are measured against their ground truth, M3500 and intel against their own optimum without
false loops; always from odometry. False loops come in four kinds (``lab/false_loops.py``), of each a number of
seeds. Every run is appended to --results as a line of JSON, and runs that are there are not repeated: it can be ended
at any time and continued later, with more --seeds or other --solvers. The first seeds of all cases are run first.

DCS, ours and GTSAM's, runs with our phi and, as ``dcs-1``, with the published one of 1, which is GTSAM's default.
GTSAM's GNC runs with its defaults and the odometry as known inliers; both by its Levenberg-Marquardt with its defaults.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from _measure import data_parser, markdown, stop
from numpy.typing import NDArray

from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import KERNELS, TRUE_EDGE_CHI2, Kernel, kernel_of
from mapmend.graph.starts import along_odometry
from mapmend.io.columns import read_columns
from mapmend.io.files import read_bytes
from mapmend.io.g2o import read_g2o
from mapmend.lab.false_loops import FALSE_LOOP_KINDS, add_false_loops

Float = NDArray[np.float64]

GRAPHS = ("intel", "M3500", "ringCity", "bicocca25b_0.500")
AS_THEY_ARE = ("bicocca25b_0.000", "bicocca25b_0.200")
COUNTS = (0, 10, 100, 500, 1000)
OURS = ("none", *KERNELS, "dcs-1")
GTSAM = ("gtsam-dcs-1", "gtsam-dcs", "gtsam-gnc")
BOUND_M = 0.1
NO_KIND = "-"


@dataclass(frozen=True)
class Case:
    """One spoiled graph."""

    graph: str
    kind: str
    count: int
    seed: int


@dataclass(frozen=True)
class Measured:
    """One solver's answer to one case."""

    graph: str
    kind: str
    count: int
    seed: int
    solver: str
    error_m: float
    seconds: float

    @property
    def case(self) -> Case:
        return Case(self.graph, self.kind, self.count, self.seed)


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--results", type=Path, default=Path("robustness.jsonl"), help="default: %(default)s")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="of each case (default: 10)")
    parser.add_argument("--solvers", nargs="+", choices=[*OURS, *GTSAM], default=[*OURS, *GTSAM], metavar="S")
    parser.add_argument("--graphs", nargs="+", choices=[*GRAPHS, *AS_THEY_ARE], default=[*GRAPHS, *AS_THEY_ARE])
    parser.add_argument("--counts", nargs="+", type=int, choices=COUNTS, default=list(COUNTS), metavar="N")
    parser.add_argument("--gnc-seeds", type=int, default=2, metavar="N", help="of GTSAM's GNC (default: 2)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="default: one a core")
    parser.add_argument("--seconds", type=float, default=math.inf, metavar="N", help="begin no run after that long")
    parser.add_argument("--only-print", action="store_true", help="the table of what was measured before")
    options = parser.parse_args()
    if not options.only_print:
        if not options.data or not (Path(options.data) / "posegraphs").is_dir():
            stop("name the folder with posegraphs/, or set MAPMEND_DATA")
        measure_all(options)
    print(tables(read_results(options.results)))


def measure_all(options: argparse.Namespace) -> None:
    """Runs what the results lack, one solver on one case at a time a process."""
    known = {(one.case, one.solver) for one in read_results(options.results)}
    todo = [
        (case, solver)
        for case in cases(options.graphs, options.counts, options.seeds)
        for solver in options.solvers
        if (case, solver) not in known and (solver != "gtsam-gnc" or case.seed < options.gnc_seeds)
    ]
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    end = time.monotonic() + options.seconds
    with ProcessPoolExecutor(options.jobs) as pool, options.results.open("a") as results:
        running: set[Future[Measured]] = set()
        for case, solver in todo:
            if time.monotonic() > end:
                break
            running.add(pool.submit(measure, options.data, case, solver))
            if len(running) >= options.jobs:
                done, running = wait(running, return_when=FIRST_COMPLETED)
                write_down(done, results)
        write_down(wait(running).done, results)


def write_down(done: set[Future[Measured]], results: IO[str]) -> None:
    for one in done:
        results.write(json.dumps(asdict(one.result())) + "\n")
    results.flush()


def cases(graphs: Sequence[str], counts: Sequence[int], seeds: int) -> Iterator[Case]:
    """Graphs as they are first, then few false loops before many, all with one seed before the next."""
    yield from (Case(graph, NO_KIND, 0, 0) for graph in graphs if 0 in counts)
    for seed in range(seeds):
        for count in counts:
            for graph in graphs:
                if count and graph not in AS_THEY_ARE:
                    yield from (Case(graph, kind, count, seed) for kind in FALSE_LOOP_KINDS)


def measure(data: str, case: Case, solver: str) -> Measured:
    """One solver on one spoiled graph, from odometry; the seconds are those of the whole call, compiled before."""
    graph, error_m = loaded(data, case.graph)
    if case.count:
        graph = add_false_loops(graph, case.kind, case.count, case.seed).graph
    began = time.perf_counter()
    poses = by_gtsam(graph, solver) if solver in GTSAM else optimize(graph, kernel=kernel_named(solver)).poses
    seconds = time.perf_counter() - began
    return Measured(case.graph, case.kind, case.count, case.seed, solver, error_m(poses), seconds)


def kernel_named(solver: str) -> Kernel | None:
    """The kernel with its own phi, or ``dcs-1`` with phi = 1."""
    return kernel_of("dcs", 1.0) if solver == "dcs-1" else kernel_of(solver)


@cache
def loaded(data: str, name: str) -> tuple[PoseGraph, Callable[[Float], float]]:
    """The graph at its odometry, and the error of poses for its nodes."""
    folder = Path(data) / "posegraphs"
    graph = read_g2o(folder / f"{name}.g2o.gz")
    graph = graph.with_poses(along_odometry(graph))
    stamps = np.arange(len(graph), dtype=np.float64)
    if name.startswith("bicocca25b"):
        stamps = read_columns(read_bytes(folder / "bicocca25b.stamps.txt.gz"), ("t",), "stamps")[0][:, 0]
        rows = read_bytes(folder / "bicocca25b.groundtruth.csv.gz").replace(b",", b" ")
        true = read_columns(rows, ("t", "x", "y", "theta"), "groundtruth")[0]
        true_stamps, truth = true[:, 0], true[:, 1:]
    elif name == "ringCity":
        true_stamps, truth = stamps, read_g2o(folder / "ringCity.groundtruth.g2o.gz").poses
    else:
        true_stamps, truth = stamps, optimize(graph).poses

    def error_m(poses: Float) -> float:
        return trajectory_errors(stamps, poses, true_stamps, truth).translation_rmse_m

    return graph, error_m


def by_gtsam(graph: PoseGraph, solver: str) -> Float:
    """The poses that GTSAM finds, the first held by a tight prior."""
    import gtsam

    factors, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.poses):
        start.insert(k, gtsam.Pose2(*pose))
    prior = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), prior))
    kernel = None
    if solver.startswith("gtsam-dcs"):
        kernel = gtsam.noiseModel.mEstimator.DCS.Create(1.0 if solver.endswith("-1") else TRUE_EDGE_CHI2)
    for k, (i, j) in enumerate(graph.edges):
        model: Any = gtsam.noiseModel.Gaussian.Information(graph.information[k])
        if kernel is not None and graph.is_loop[k]:
            model = gtsam.noiseModel.Robust.Create(kernel, model)
        factors.add(gtsam.BetweenFactorPose2(int(i), int(j), gtsam.Pose2(*graph.measurements[k]), model))
    if kernel is not None:
        found = gtsam.LevenbergMarquardtOptimizer(factors, start, gtsam.LevenbergMarquardtParams()).optimize()
    else:
        parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
        parameters.setKnownInliers([0, *(1 + np.flatnonzero(~graph.is_loop)).tolist()])
        found = gtsam.GncLMOptimizer(factors, start, parameters).optimize()
    poses = [found.atPose2(k) for k in range(len(graph))]
    return np.array([[pose.x(), pose.y(), pose.theta()] for pose in poses])


def read_results(path: Path) -> list[Measured]:
    """What was measured before."""
    if not path.is_file():
        return []
    return [Measured(**json.loads(line)) for line in path.read_text().splitlines()]


def tables(results: Sequence[Measured]) -> str:
    """A table of errors a graph, and one of all graphs: how often the error stays within the bound."""
    by_graph: dict[str, list[Measured]] = defaultdict(list)
    for one in results:
        by_graph[one.graph].append(one)
    parts = []
    as_they_are = [one for one in results if one.count == 0]
    parts.append("### Without false loops of ours: error [m]\n\n" + error_table(as_they_are, lambda one: one.graph))
    for graph in GRAPHS:
        spoiled = [one for one in by_graph[graph] if one.count]
        head = f"### {graph}: median (worst) error [m] over the seeds"
        parts.append(f"{head}\n\n" + error_table(spoiled, lambda one: f"{one.count} {one.kind}"))
    parts.append(f"### Share of runs that end within {BOUND_M} m of what is reached without false loops and kernel\n\n")
    parts[-1] += share_table(results)
    return "\n\n".join(parts)


def error_table(results: Sequence[Measured], row_of: Callable[[Measured], str]) -> str:
    """Rows by case, columns by solver; the number of seeds where it is not that of the first column."""
    solvers = [s for s in (*OURS, *GTSAM) if any(one.solver == s for one in results)]
    cells: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for one in sorted(results, key=lambda one: (one.count, FALSE_LOOP_KINDS.index(one.kind) if one.count else 0)):
        cells[row_of(one)][one.solver].append(one.error_m)
    rows = [
        (name, str(max(map(len, by_solver.values()))), *(error_cell(by_solver[s], by_solver) for s in solvers))
        for name, by_solver in cells.items()
    ]
    return markdown(("false loops", "seeds", *solvers), rows)


def error_cell(errors: Sequence[float], by_solver: dict[str, list[float]]) -> str:
    if not errors:
        return ""
    most = max(map(len, by_solver.values()))
    text = f"{statistics.median(errors):.3f}"
    text += f" ({max(errors):.3f})" if len(errors) > 1 else ""
    return text if len(errors) == most else f"{text} of {len(errors)}"


def share_table(results: Sequence[Measured]) -> str:
    """How many runs end near what the graph without false loops gives, and the median seconds of all."""
    clean = {one.graph: one.error_m for one in results if one.count == 0 and one.solver == "none"}
    rows = []
    for solver in (*OURS, *GTSAM):
        mine = [one for one in results if one.solver == solver and one.graph in GRAPHS and one.count]
        if not mine:
            continue
        cells = []
        for graph in GRAPHS:
            runs = [one for one in mine if one.graph == graph]
            good = sum(one.error_m <= clean.get(graph, np.nan) + BOUND_M for one in runs)
            cells.append(f"{good} / {len(runs)}")
        rows.append((solver, *cells, f"{statistics.median(one.seconds for one in mine):.2f}"))
    return markdown(("solver", *GRAPHS, "median seconds"), rows)


if __name__ == "__main__":
    main()
