"""``mapmend optimize``: moves a pose graph to its optimum."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmend.commands.common.console import ProgressBar, print_json, say_notes, table, told_compiling
from mapmend.commands.common.options import KERNELS, STARTS, add_threads, positive_number, thread_count
from mapmend.errors import InputError, MapmendError
from mapmend.io.formats import PACKED, graph_format_of
from mapmend.io.output import check_file_writable

if TYPE_CHECKING:
    from mapmend.graph.best_start import StartedResult
    from mapmend.graph.pose_graph import PoseGraph
    from mapmend.graph.robust import Kernel

MOST_ROWS = 20


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = (
        "Reads and writes g2o and TORO; scans on the nodes are kept. With a kernel, lists the loops that it distrusts."
    )
    parser.add_argument("graph", metavar="GRAPH", help="a g2o or TORO graph (.gz and .bz2 too)")
    parser.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        required=True,
        help="the file to write: .g2o, or .toro or .graph; with any other name, in the format of GRAPH",
    )
    parser.add_argument(
        "--kernel", choices=("none", *KERNELS), default="none", help="robust cost of the loop edges (default: none)"
    )
    parser.add_argument(
        "--phi",
        type=positive_number,
        metavar="X",
        help="chi2 from which on the kernel lowers an edge's weight (default: the kernel's own)",
    )
    parser.add_argument(
        "--init",
        choices=("auto", *STARTS),
        default="auto",
        help="the poses to start from: those in GRAPH (given), along the odometry (best with a kernel), along a "
        "spanning tree of the most certain edges, or rotations first, then positions (chordal); auto (default): "
        "given, and chordal too where that ends badly",
    )
    parser.add_argument("--all-edges", action="store_true", help="apply the kernel to odometry edges too")
    add_threads(parser)


def run(args: Namespace) -> int:
    """Reads, optimizes, writes; bad arguments are refused before the work begins."""
    import numpy as np

    from mapmend.datasets.cache import named_file
    from mapmend.graph.best_start import optimize_from
    from mapmend.graph.optimizer import edge_chi2
    from mapmend.graph.robust import kernel_of
    from mapmend.io.graph_text import write_graph

    kernel = kernel_of(args.kernel, args.phi)
    if kernel is None and (args.phi is not None or args.all_edges):
        raise MapmendError("--phi and --all-edges say how a kernel doubts; name one with --kernel")
    if Path(args.output).suffix in PACKED:
        raise MapmendError(f"{args.output}: graphs are written plain; name it without {Path(args.output).suffix}")
    check_file_writable(args.output, [named_file(args.graph)])
    began = time.perf_counter()
    graph, written_as = read_graph(named_file(args.graph))
    seconds = {"read": time.perf_counter() - began}
    with ProgressBar() as progress, told_compiling() as compiling:
        given_chi2 = float(edge_chi2(graph).sum())
        doubted = np.ones_like(graph.is_loop) if args.all_edges else graph.is_loop
        threads = thread_count(args.threads)
        found = optimize_from(graph, args.init, progress=progress, kernel=kernel, doubted=doubted, threads=threads)
    optimized = graph.with_poses(found.result.poses)
    seconds |= found.seconds | {"compile": compiling.seconds}
    began = time.perf_counter()
    write_graph(args.output, optimized, graph_format_of(args.output) or written_as)
    seconds["write"] = time.perf_counter() - began
    say_notes(graph.notes)
    values = _values(args, kernel, optimized, found, given_chi2) | {"seconds": seconds}
    if args.json:
        print_json(values)
    else:
        print("\n".join(_lines(values)))
    return 0


def read_graph(path: Path) -> tuple[PoseGraph, str]:
    """The graph in a file, and whether its lines are g2o's or TORO's; raises InputError for other content."""
    from mapmend.io.files import read_bytes
    from mapmend.io.graph_lines import parse_graph
    from mapmend.io.reader import recognise

    data = read_bytes(path)
    if recognise(data, path) != "graph":
        raise InputError(path, "holds no pose graph", "name a g2o or TORO graph")
    written_as = "toro" if b"VERTEX2 " in data or b"EDGE2 " in data else "g2o"
    return parse_graph(data, path), written_as


def _values(
    args: Namespace, kernel: Kernel | None, graph: PoseGraph, found: StartedResult, given_chi2: float
) -> dict[str, Any]:
    """The output of ``--json``, without the seconds; ``init`` is the start that was taken, ``ends`` those tried."""
    from mapmend.graph.optimizer import edge_chi2
    from mapmend.graph.robust import distrusted

    result = found.result
    rows, chi2 = distrusted(result.edge_weights), edge_chi2(graph)
    loops = graph.is_loop
    return {
        "graph": args.graph,
        "output": args.output,
        "nodes": len(graph),
        "edges": len(graph.edges),
        "loops": int(loops.sum()),
        "kernel": args.kernel,
        "phi": None if kernel is None else kernel.phi,
        "init": found.taken,
        "ends": [asdict(end) for end in found.ends],
        "chi2_initial": given_chi2,
        "chi2_start": result.chi2_initial,
        "chi2_final": result.chi2_final,
        "cost_initial": result.cost_initial,
        "cost_final": result.cost_final,
        "iterations": result.iterations,
        "converged": result.converged,
        "distrusted": [
            {"edge": row, "from": i, "to": j, "chi2": float(chi2[row]), "weight": float(result.edge_weights[row])}
            for row, (i, j) in zip(rows.tolist(), graph.ids[graph.edges[rows]].tolist(), strict=True)
        ],
    }


def _lines(values: dict[str, Any]) -> list[str]:
    """The same as text."""
    seconds = values["seconds"]
    spent = {name: value for name, value in seconds.items() if name != "compile"}
    compiled = f"; {seconds['compile']:.1f} of them compiling" if seconds["compile"] else ""
    parts = ", ".join(f"{name} {value:.3f}" for name, value in spent.items())
    state = "converged" if values["converged"] else "not converged"
    lines = [
        f"{values['graph']}: {values['nodes']} nodes, {values['edges']} edges, {values['loops']} of them loops",
        f"  chi2: {values['chi2_initial']:.3f} before, {values['chi2_final']:.3f} after, "
        f"{values['iterations']} iterations, {state}",
    ]
    lines += _start_lines(values)
    if values["phi"] is not None:
        lines.append(
            f"  kernel {values['kernel']}, phi {values['phi']:g}: cost {values['cost_initial']:.3f} before, "
            f"{values['cost_final']:.3f} after"
        )
    lines += _distrust_lines(values["distrusted"]) if values["phi"] is not None else []
    return [*lines, f"  seconds: {sum(spent.values()):.3f} ({parts}{compiled})", f"  graph: {values['output']}"]


def _start_lines(values: dict[str, Any]) -> list[str]:
    """Which start was taken; if several were tried, the end of each."""
    ends = values["ends"]
    if len(ends) == 1:
        return [] if values["init"] == "given" else [f"  start: {values['init']}, chi2 {values['chi2_start']:.3f}"]
    has_kernel = values["phi"] is not None
    reached = [
        f"from {end['start']} chi2 {end['chi2']:.3f}"
        + (f", cost {end['cost']:.3f}" if has_kernel else "")
        + (f", given up after {end['iterations']} steps" if end["given_up"] else "")
        for end in ends
    ]
    return [f"  start: {values['init']}, the better of {len(ends)}: {'; '.join(reached)}"]


def _distrust_lines(rows: list[dict[str, Any]]) -> list[str]:
    """The least trusted edges, the worst first."""
    from mapmend.graph.robust import DISTRUST_WEIGHT

    lines = [f"  distrusts {len(rows)} edges (weight below {DISTRUST_WEIGHT:g})"]
    worst = sorted(rows, key=lambda row: (row["weight"], -row["chi2"]))[:MOST_ROWS]
    if worst:
        cells = [
            (f"{row['from']} -> {row['to']}", str(row["edge"]), f"{row['chi2']:.1f}", f"{row['weight']:.2g}")
            for row in worst
        ]
        lines += [f"    {line}" for line in table(("nodes", "edge", "chi2", "weight"), cells).splitlines()]
    if len(rows) > len(worst):
        lines.append(f"    and {len(rows) - len(worst)} more; --json names all")
    return lines
