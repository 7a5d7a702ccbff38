"""The kernel's parameter by map consistency beside fixed ones: MC Figure 4 on the scan graphs here.

Graphs get false loops (``lab/false_loops.py``) and, in the cases called corrupted, an initial guess with large random
errors of the nodes; the others start along the odometry. Every solver's map is measured against the true relations,
beside the optimum of the clean graph. Every case is appended to --results as a line of JSON, and cases that are there
are not repeated.

``--what sweep`` finds the least M of a dense sweep of 400 values, over all pairs of scans (``_tuning_sweep.py``; with
``--whole`` all values are measured over all pairs), and compares phi* of the same case with it. ``--what shortcut``
measures the pairs of one graph's grid with and without leaving out those that hardly moved; ``--what noise``
estimates how certain it is that M is larger at other values of phi (``_tuning_noise.py``).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from _measure import data_parser, markdown, stop
from _tuning_noise import differences
from _tuning_sweep import MARGIN, VALUES, sweep
from numpy.typing import NDArray

from mapmend.consistency.check import check
from mapmend.consistency.visibility import view_scans
from mapmend.evaluation.relations import relation_errors
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import distrusted, kernel_of
from mapmend.graph.starts import along_odometry
from mapmend.io.reader import read
from mapmend.io.relations import Relations, read_relations
from mapmend.lab.false_loops import add_false_loops
from mapmend.tuning import tune as tuning
from mapmend.tuning.pair_sample import Evaluation, PairSample
from mapmend.tuning.search import grid_roots
from mapmend.tuning.solutions import Solution, solve

Float = NDArray[np.float64]

GRAPHS = ("intel", "fr079")
KINDS = ("random", "local", "random-groups", "local-groups")
COUNTS = (50, 200, 1000)
SOLVERS = {"none": None, "phi = 1": kernel_of("dcs", 1.0), "phi = 11.3": kernel_of("dcs"), "gnc": kernel_of("gnc")}
GUESS_STD = np.array([1.0, 1.0, np.radians(20.0)])
"""The random error of each node in a corrupted initial guess, m, m, rad."""

NOISE_PHIS = (0.02, 0.0625, 0.25, 1.0, 4.0, 16.0)

MOST_TIMES = 1.2
"""The error at phi* should be at most this many times that of the clean graph's optimum."""


@dataclass(frozen=True)
class Case:
    """One spoiled graph and where its solves start: "odometry" or "corrupted"."""

    graph: str
    kind: str
    count: int
    start: str
    seed: int

    @property
    def name(self) -> str:
        spoiled = f"{self.count} {self.kind}" if self.count else "no false loops"
        return f"{self.graph}, {spoiled}" + (", corrupted guess" if self.start == "corrupted" else "")


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument(
        "--what", choices=("errors", "sweep", "shortcut", "noise"), default="errors", help="default: errors"
    )
    parser.add_argument("--results", type=Path, default=Path("tuning.jsonl"), help="default: %(default)s")
    parser.add_argument("--graphs", nargs="+", choices=GRAPHS, default=list(GRAPHS))
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--counts", nargs="+", type=int, default=[0, *COUNTS], metavar="N")
    parser.add_argument("--starts", nargs="+", choices=("odometry", "corrupted"), default=["odometry", "corrupted"])
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="of each case (default: 1)")
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="default: 2")
    parser.add_argument("--all-pairs", action="store_true", help="shortcut: of all pairs, not of the sample")
    parser.add_argument("--whole", action="store_true", help="sweep: all values over all pairs too")
    parser.add_argument("--only-print", action="store_true", help="the tables of what was measured before")
    options = parser.parse_args()
    if not options.data or not (Path(options.data) / "scangraphs").is_dir():
        stop("name the folder with scangraphs/ and relations/, or set MAPMEND_DATA")
    if options.what == "shortcut":
        print(shortcut_table(options))
        return
    if options.what == "noise":
        print(noise_table(options))
        return
    if not options.only_print:
        measure_all(options)
    results = read_results(options.results)
    print(error_table(results) if options.what == "errors" else sweep_table(results))


def measure_all(options: argparse.Namespace) -> None:
    """Runs what the results lack, a case at a time."""
    known = {(row["what"], json.dumps(row["case"], sort_keys=True)) for row in read_results(options.results)}
    measure = measure_errors if options.what == "errors" else measure_sweep
    for case in cases(options):
        if (options.what, json.dumps(asdict(case), sort_keys=True)) in known:
            continue
        row = {"what": options.what, "case": asdict(case), **measure(options, case)}
        with options.results.open("a") as results:
            results.write(json.dumps(row) + "\n")


def cases(options: argparse.Namespace) -> list[Case]:
    """Odometry before corrupted guesses, few false loops before many."""
    found = []
    for seed in range(options.seeds):
        for start in options.starts:
            for count in options.counts:
                kinds = options.kinds if count else ["-"]
                if count or seed == 0:
                    found += [Case(graph, kind, count, start, seed) for kind in kinds for graph in options.graphs]
    return found


@cache
def loaded(data: str, name: str) -> tuple[PoseGraph, Relations, Float]:
    """A graph as it is, its true relations, and the poses of its optimum."""
    graph = read(Path(data) / "scangraphs" / f"{name}.toro.gz")
    assert isinstance(graph, PoseGraph)
    relations = read_relations(Path(data) / "relations" / f"{name}.relations")
    return graph, relations, optimize(graph).poses


def spoiled(data: str, case: Case) -> PoseGraph:
    """The graph of a case, at the poses where every solve starts."""
    graph, _, clean = loaded(data, case.graph)
    if case.count:
        graph = add_false_loops(graph, case.kind, case.count, case.seed).graph
    if case.start == "odometry":
        return graph.with_poses(along_odometry(graph))
    thrown = clean + GUESS_STD * np.random.default_rng([case.seed, 7]).standard_normal(clean.shape)
    thrown[list(graph.fixed)] = clean[list(graph.fixed)]
    return graph.with_poses(thrown)


def errors_of(data: str, name: str, poses: Float) -> tuple[float, float]:
    """Mean error of the relations that the nodes reach, m and degrees."""
    graph, relations, _ = loaded(data, name)
    assert graph.stamps_s is not None
    found = relation_errors(graph.stamps_s, poses, relations.t1_s, relations.t2_s, relations.relative_poses)
    return found.translation_mean_m, found.rotation_mean_deg


def measure_errors(options: argparse.Namespace, case: Case) -> dict[str, Any]:
    """Errors of all solvers, and of tune with its verdict."""
    start = spoiled(options.data, case)
    rows: dict[str, Any] = {"clean": errors_of(options.data, case.graph, loaded(options.data, case.graph)[2])}
    for name, kernel in SOLVERS.items():
        rows[name] = errors_of(options.data, case.graph, optimize(start, kernel=kernel).poses)
    began, cpu = time.perf_counter(), time.process_time()
    result = tuning.tune(start, init="given", threads=options.threads)
    seconds = {"wall": time.perf_counter() - began, "cpu": time.process_time() - cpu}
    rows["phi*"] = errors_of(options.data, case.graph, result.graph.poses)
    false = np.arange(len(start.edges)) >= len(loaded(options.data, case.graph)[0].edges)
    off = np.zeros(len(start.edges), np.bool_)
    off[result.switched_off] = True
    return {
        "errors": rows,
        "phi": result.phi,
        "measure": result.measure_m,
        "overlapping": result.overlapping,
        "measure_1": result.measure_at(1.0),
        "false_off": int(np.count_nonzero(off & false)),
        "true_off": int(np.count_nonzero(off & ~false)),
        "consistent": result.consistent,
        "p_value": result.check.p_value,
        "consistent_1": check(result.published, threads=options.threads).consistent,
        "measured": result.measured / max(result.asked, 1),
        "seconds": seconds,
    }


def measure_sweep(options: argparse.Namespace, case: Case) -> dict[str, Any]:
    """The least M of the sweep, over all pairs (``_tuning_sweep``); with --whole all relation errors, m, too."""
    began, cpu = time.perf_counter(), time.process_time()
    row, solutions = sweep(spoiled(options.data, case), options.threads, options.whole)
    row["seconds"] = {"wall": time.perf_counter() - began, "cpu": time.process_time() - cpu}
    if options.whole:
        row["phis"] = [s.phi for s in solutions]
        row["errors_m"] = [errors_of(options.data, case.graph, s.poses)[0] for s in solutions]
    return row


def scans_of(graph: PoseGraph) -> Any:
    assert graph.scans is not None
    return graph.scans


def shortcut_table(options: argparse.Namespace) -> str:
    """The grid of each graph without and with the shortcut: seconds, pairs measured, how far M differs."""
    rows = []
    for name in options.graphs:
        for count in options.counts:
            start = spoiled(options.data, Case(name, "random", count, "odometry", 0))
            solutions = solve(start, "dcs", [r * r for r in grid_roots()], threads=options.threads)
            poses = [s.poses for s in solutions if isinstance(s, Solution)]
            views = view_scans(scans_of(start), tuning.DEFAULT_CONFIG.consistency)
            stride = 1 if options.all_pairs else tuning.sample_of(views.placed(start.poses)).stride
            whole = PairSample(views, stride)
            plain, *spent = timed(whole, poses, -1.0, options.threads)
            rows.append((f"{name}, {count} false loops", "no", *cells(whole, plain, plain, spent)))
            sample = PairSample(views, stride)
            limit = tuning.TOLERANCE * float(plain.sum_m.min()) / len(whole.pairs)
            found, *spent = timed(sample, poses, limit, options.threads)
            rows.append((f"{name}, {count} false loops", "yes", *cells(sample, found, plain, spent)))
    head = ("graph", "shortcut", "pairs", "measured", "wall s", "CPU s", "M differs by", "bound")
    return markdown(head, rows)


def noise_table(options: argparse.Namespace) -> str:
    """M at other values of phi beside that at phi* of the clean graphs, with its standard error; relation errors."""
    rows = []
    for name in options.graphs:
        start = spoiled(options.data, Case(name, "-", 0, "odometry", 0))
        best = tuning.tune(start, init="given", threads=options.threads).least_phi
        phis = [best, *(phi for phi in NOISE_PHIS if phi != best)]
        found = [s for s in solve(start, "dcs", phis, threads=options.threads) if isinstance(s, Solution)]
        above = differences(start, [s.poses for s in found], options.threads)
        for solution, (more, error) in zip(found, above, strict=True):
            off = f"{len(distrusted(solution.edge_weights))} of {int(start.is_loop.sum())}"
            error_m = f"{errors_of(options.data, name, solution.poses)[0]:.4f}"
            rows.append((name, f"{solution.phi:.4g}", f"{more:+.2%}", f"{error:.2%}", off, error_m))
    return markdown(("graph", "phi", "M above its least", "standard error", "loops off", "error m"), rows)


def timed(sample: PairSample, poses: list[Float], limit_m: float, threads: int) -> tuple[Evaluation, float, float]:
    """The sums, and the seconds by the clock and by the processor."""
    began, cpu = time.perf_counter(), time.process_time()
    found = sample.evaluate(poses, limit_m, threads=threads)
    return found, time.perf_counter() - began, time.process_time() - cpu


def cells(sample: PairSample, found: Evaluation, plain: Evaluation, spent: Sequence[float]) -> tuple[str, ...]:
    off = np.max(np.abs(found.sum_m - plain.sum_m) / plain.sum_m)
    return (
        f"{len(sample.pairs):,}",
        f"{found.measured / found.asked:.0%}",
        *(f"{seconds:.2f}" for seconds in spent),
        f"{off:.4%}",
        f"{np.max(found.bound_m / plain.sum_m):.2%}",
    )


def read_results(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def grouped(results: Sequence[dict[str, Any]], what: str) -> dict[str, list[dict[str, Any]]]:
    """The results of each graph, number of false loops and start: over their kinds and seeds."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in results:
        if row["what"] == what:
            case = Case(**row["case"])
            name = f"{case.graph}, {case.count}" + (", corrupted guess" if case.start == "corrupted" else "")
            groups.setdefault(name, []).append(row)
    return groups


def error_table(results: Sequence[dict[str, Any]]) -> str:
    """A row a group: the worst errors by solver, m; loops off and M from least to most; how many maps pass."""
    rows = []
    for name, cases in grouped(results, "errors").items():
        worst = {s: max(row["errors"][s][0] for row in cases) for s in ("clean", *SOLVERS, "phi*")}
        verdicts = [sum(row[key] for row in cases) for key in ("consistent", "consistent_1")]
        rows.append(
            (
                name,
                str(len(cases)),
                *(f"{error:.4f}" for error in worst.values()),
                span([row["phi"] for row in cases], "{:.3g}"),
                span([row["measure"] for row in cases], "{:.3f}"),
                span([row["measure_1"] for row in cases], "{:.3f}"),
                span([row["false_off"] for row in cases], "{}"),
                span([row["true_off"] for row in cases], "{}"),
                f"{verdicts[0]} ({verdicts[1]})",
            )
        )
    more = ("phi*", "phi* is", "M", "M at 1", "false off", "true off", "consistent (at 1)")
    spoilt = [row for row in results if row["what"] == "errors" and row["case"]["count"]]
    ratios = [row["errors"]["phi*"][0] / row["errors"]["clean"][0] for row in spoilt]
    good = sum(ratio <= MOST_TIMES for ratio in ratios)
    words = (
        f"Within {MOST_TIMES} times the clean error: {good} of {len(spoilt)} cases with false loops, "
        f"the worst at {max(ratios, default=0.0):.3f}."
    )
    return f"{markdown(('graph, false loops', 'cases', 'clean', *SOLVERS, *more), rows)}\n\n{words}"


def span(values: Sequence[float], form: str) -> str:
    """The least and the most, once if they are the same."""
    ends = [form.format(value) for value in (min(values), max(values))]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def sweep_table(results: Sequence[dict[str, Any]]) -> str:
    """A row a group: how far M at phi*, where --what errors measured it, lies above the sweep's least."""
    tuned = {json.dumps(row["case"]): row for row in results if row["what"] == "errors"}
    rows, all_above = [], []
    for name, cases in grouped(results, "sweep").items():
        pairs = [(row, tuned[json.dumps(row["case"])]) for row in cases if json.dumps(row["case"]) in tuned]
        if not pairs:
            continue
        above = [mine["measure"] * mine["overlapping"] / row["sweep_sum_m"] - 1.0 for row, mine in pairs]
        all_above += above
        rows.append(
            (
                name,
                str(len(pairs)),
                span([mine["phi"] for _, mine in pairs], "{:.3g}"),
                span([row["sweep_phi"] for row, _ in pairs], "{:.3g}"),
                span(above, "{:+.2%}"),
                span([row["stages"][1][1] for row, _ in pairs], "{}"),
                span([row["stages"][-1][1] for row, _ in pairs], "{}"),
            )
        )
    head = ("graph, false loops", "cases", "phi*", f"of {VALUES} values", "M above its least", "left", "over all pairs")
    words = (
        f"At most {max(all_above, default=0.0):.2%} above the least of {len(all_above)} sweeps, "
        f"which is known to {MARGIN:.1%}."
    )
    whole = [whole_words(row) for row in results if row["what"] == "sweep" and "whole_sum_m" in row]
    return "\n\n".join((markdown(head, rows), words, *whole))


def whole_words(row: dict[str, Any]) -> str:
    """What measuring all values over all pairs says of the narrowing, at worst."""
    above = row["whole_sum_m"] / row["sweep_sum_m"] - 1.0
    off = ", ".join(f"{errors:.1f}" for errors in row["farthest"])
    return (
        f"{Case(**row['case']).name}: the least of all {VALUES} values over all pairs lies {above:+.3%} beside the one "
        f"found (known to {row['whole_bound']:.2%}); the samples' differences were off by {off} standard errors."
    )


if __name__ == "__main__":
    main()
