"""``mapmend tune``: the kernel's parameter that gives the most consistent map, and that map."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmend.commands.common.console import ProgressBar, print_json, say, say_notes, say_older, table, told_compiling
from mapmend.commands.common.inputs import load_graph
from mapmend.commands.common.options import KERNELS, STARTS, add_config, add_threads, read_config, thread_count
from mapmend.errors import InputError, MapmendError, OutputError
from mapmend.io.formats import graph_format_of
from mapmend.io.output import (
    check_file_writable,
    check_own_writable,
    check_writable,
    whole_or_nothing,
    write_own,
    write_whole,
)
from mapmend.io.own_files import TUNE_FILES, is_run
from mapmend.version import VERSION

if TYPE_CHECKING:
    from mapmend.tuning.tune import TuneResult

INCONSISTENT = 1
GRAPH, PICTURE = "graph.g2o", "tune.png"
MOST_ROWS = 10


@dataclass(frozen=True)
class Outputs:
    """Where the optimized graph and the picture go; ``folder`` is the one that was named for both, if any."""

    graph: Path
    format: str
    picture: Path
    folder: Path | None = None


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = (
        "Needs a pose graph whose nodes carry scans, and no ground truth. Lists the loops that it switched off."
    )
    parser.add_argument("graph", metavar="RUN|GRAPH", help="a RUN folder, or a g2o or TORO graph (.gz and .bz2 too)")
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        help="a folder for graph.g2o and tune.png; or the file for the graph (.g2o, .toro, .graph), with tune.png "
        "beside it (default: write nothing)",
    )
    parser.add_argument("--kernel", choices=KERNELS, default="dcs", help="the kernel to tune (default: dcs)")
    parser.add_argument(
        "--init",
        choices=STARTS,
        default="odometry",
        help="the poses that every solution starts from: along the odometry (default), given: those in GRAPH, along a "
        "spanning tree of the most certain edges, or chordal: rotations first, then positions",
    )
    add_config(parser)
    add_threads(parser)


def run(args: Namespace) -> int:
    """Tunes ``args.graph``; returns 0 if the map is consistent, 1 if no phi gives a consistent one."""
    from mapmend.tuning.tune import tune

    config = read_config(args)
    outputs = _outputs(args.output, args.graph)
    began = time.perf_counter()
    graph = load_graph(args.graph)
    seconds = {"read": time.perf_counter() - began}
    began = time.perf_counter()
    try:
        with ProgressBar() as progress, told_compiling() as compiling:
            result = tune(
                graph,
                config,
                kernel=args.kernel,
                init=args.init,
                threads=thread_count(args.threads),
                progress=progress,
            )
    except MapmendError as error:
        raise InputError(args.graph, str(error)) from error
    seconds |= {"tune": time.perf_counter() - began, "compile": compiling.seconds}
    say_notes(graph.notes)
    for note in result.notes:
        say(f"note: {note}")
    began = time.perf_counter()
    if outputs is not None:
        _write(outputs, result, args)
    seconds["write"] = time.perf_counter() - began
    values = report(args, result, outputs) | {"seconds": {k: round(v, 3) for k, v in seconds.items()}}
    if args.json:
        print_json(values)
    else:
        print("\n".join(lines(values)))
    return 0 if result.consistent else INCONSISTENT


def _outputs(output: str | None, source: str) -> Outputs | None:
    """A name with a graph's suffix is the graph's, with the picture beside it; any other is a folder for both."""
    if not output:
        return None
    path = Path(output)
    form = graph_format_of(path)
    if form is not None:
        check_file_writable(path, [source])
        check_own_writable(path.with_name(PICTURE))
        return Outputs(path, form, path.with_name(PICTURE))
    if is_run(path):
        raise OutputError(f"{path}: holds a RUN, whose graph belongs to its map; name another folder")
    check_writable(path, TUNE_FILES)
    if path.is_dir():
        check_file_writable(path / GRAPH, [source])
    return Outputs(path / GRAPH, "g2o", path / PICTURE, path)


def _write(outputs: Outputs, result: TuneResult, args: Namespace) -> None:
    from mapmend.io.graph_text import write_graph
    from mapmend.view.tune_picture import tune_png

    picture = tune_png(result, Path(args.graph).name)
    if outputs.folder is None:
        write_own(outputs.picture, picture)
        write_graph(outputs.graph, result.graph, outputs.format)
        return
    with whole_or_nothing(outputs.folder, TUNE_FILES) as output:
        write_graph(output.path / GRAPH, result.graph, outputs.format)
        write_whole(output.path / PICTURE, picture)
        run_json = output.write_run_json(_run_json(result, args))
    say_older(run_json)


def _run_json(result: TuneResult, args: Namespace) -> dict[str, Any]:
    """What run.json says of a tuned graph, besides the list of files."""
    return {
        "mapmend": VERSION,
        "graph": Path(args.graph).name,
        "kernel": result.kernel,
        "init": args.init,
        "phi": result.phi,
        "measure": result.measure_m,
        "consistent": result.consistent,
        "p_value": result.check.p_value,
    }


def report(args: Namespace, result: TuneResult, outputs: Outputs | None) -> dict[str, Any]:
    """The output of ``--json``, without the seconds; nodes by their ids."""
    from mapmend.graph.optimizer import edge_chi2
    from mapmend.graph.robust import TRUE_EDGE_CHI2
    from mapmend.tuning.tune import PUBLISHED_PHI

    graph, chi2 = result.graph, edge_chi2(result.graph)
    verdict = result.check
    return {
        "graph": args.graph,
        "output": str(outputs.graph) if outputs else None,
        "picture": str(outputs.picture) if outputs else None,
        "nodes": len(graph),
        "loops": int(graph.is_loop.sum()),
        "kernel": result.kernel,
        "init": args.init,
        "phi": result.phi,
        "least_phi": result.least_phi,
        "measure": result.measure_m,
        "measure_published": result.measure_at(PUBLISHED_PHI),
        "overlapping": result.overlapping,
        "curve": [[phi, m] for phi, m in zip(result.curve_phi.tolist(), result.curve_m.tolist(), strict=True)],
        "curve_bound": result.curve_bound,
        "sampled": result.sampled,
        "pairs_measured": result.measured,
        "pairs_asked": result.asked,
        "consistent": result.consistent,
        "p_value": verdict.p_value,
        "verdicts": [checked._asdict() for checked in result.verdicts],
        "scans_tested": verdict.scans.count,
        "scans_inconsistent": int(verdict.scans.failed.sum()),
        "switched_off": [
            {"edge": row, "from": i, "to": j, "chi2": float(chi2[row]), "weight": float(result.edge_weights[row])}
            for row, (i, j) in zip(
                result.switched_off.tolist(), graph.ids[graph.edges[result.switched_off]].tolist(), strict=True
            )
        ],
        "contradicting": int((chi2[result.switched_off] > TRUE_EDGE_CHI2).sum()),
        "notes": [*map(str, graph.notes), *result.notes],
    }


def lines(values: dict[str, Any]) -> list[str]:
    """The report as text."""
    from mapmend.tuning.tune import PUBLISHED_PHI

    seconds = {name: value for name, value in values["seconds"].items() if name != "compile"}
    compiled = f"; {values['seconds']['compile']:.1f} of them compiling" if values["seconds"]["compile"] else ""
    spent = ", ".join(f"{name} {value:.1f}" for name, value in seconds.items())
    published = values["measure_published"]
    beside = "" if published is None else f"; with phi = {PUBLISHED_PHI:g} it is {published:.4g} m"
    text = [
        f"{values['graph']}: {values['nodes']} nodes, {values['loops']} loop edges, kernel {values['kernel']}",
        f"  phi = {values['phi']:.4g}: scans contradict each other by {values['measure']:.4g} m a pair{beside}",
        f"  looked at {len(values['curve'])} values of phi, at one pair of scans in {round(1.0 / values['sampled'])}",
        *_off_lines(values),
        f"  seconds: {sum(seconds.values()):.1f} ({spent}{compiled})",
    ]
    text += [f"  graph: {values['output']}", f"  picture: {values['picture']}"] if values["output"] else []
    counts = f"{values['scans_inconsistent']} of {values['scans_tested']} scans contradict the others"
    if values["consistent"]:
        return [*text, f"the map is consistent: p = {values['p_value']:.3g}, {counts}"]
    others = [checked["p_value"] for checked in values["verdicts"][1:]]
    minima = "the other minimum" if len(others) == 1 else f"{len(others)} other minima"
    beside = f"; the maps at {minima} of M fail too, p at most {max(others):.3g}" if others else ""
    return [*text, f"no phi gives a consistent map: at the best one p = {values['p_value']:.3g}, {counts}{beside}"]


def _off_lines(values: dict[str, Any]) -> list[str]:
    """The loops that were switched off, the worst first, and how many of them contradict the map."""
    from mapmend.graph.robust import TRUE_EDGE_CHI2

    rows = values["switched_off"]
    if not rows:
        return ["  switched off no loop"]
    text = [
        f"  switched off {len(rows)} of {values['loops']} loops: {values['contradicting']} contradict the map "
        f"(chi2 above {TRUE_EDGE_CHI2:.1f})"
    ]
    if len(rows) > values["contradicting"]:
        text.append(
            f"    the other {len(rows) - values['contradicting']} agree with it within their covariances: so small a "
            "phi keeps only loops that fit closer"
        )
    worst = sorted(rows, key=lambda row: -row["chi2"])[:MOST_ROWS]
    cells = [(f"{r['from']} -> {r['to']}", str(r["edge"]), f"{r['chi2']:.1f}", f"{r['weight']:.2g}") for r in worst]
    text += [f"    {line}" for line in table(("nodes", "edge", "chi2", "weight"), cells).splitlines()]
    return [*text, f"    and {len(rows) - len(worst)} more; --json names all"] if len(rows) > len(worst) else text
