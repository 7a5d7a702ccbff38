"""``mapmend map``: makes a RUN folder from a log."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from threading import Thread
from typing import Any

from mapmend.commands.common.console import ProgressBar, print_json, say, say_notes, say_older, told_compiling
from mapmend.commands.common.options import (
    METHODS,
    add_bag,
    add_lenient,
    add_settings,
    add_threads,
    bag_options,
    map_config,
    thread_count,
)
from mapmend.io.output import check_writable
from mapmend.io.own_files import RUN_FILES


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "The RUN folder holds trajectory.tum, graph.g2o, map.pgm with map.yaml, map.png and run.json."
    parser.add_argument("log", metavar="LOG", help="a CARMEN log (.gz and .bz2 too) or a ROS bag")
    parser.add_argument(
        "-o", "--output", metavar="RUN", required=True, help="the folder to write; replaces a RUN's files in it"
    )
    parser.add_argument(
        "--method",
        choices=METHODS,
        default=METHODS[0],
        help="igo: match, close loops, optimize, then match biased edges again (default); go: the same without "
        "matching again; scanmatch: without loops; odometry: the poses in the log; gmapping: a particle filter",
    )
    add_settings(parser)
    add_bag(parser)
    add_lenient(parser)
    add_threads(parser)


def _import_ahead() -> None:
    """Imports the modules for matching while the log is decompressed: both take about equally long, each on one
    core."""
    import mapmend.igo.iterate  # noqa: F401


def run(args: Namespace) -> int:
    """Reads, maps, writes; bad arguments are refused before the work begins."""
    from mapmend.datasets.cache import named_file
    from mapmend.io.read_log import read_log
    from mapmend.run_folder import write_run
    from mapmend.slam import build_map, check_method

    config = map_config(args)
    check_method(args.method, config)
    check_writable(args.output, RUN_FILES)
    imports = Thread(target=_import_ahead, daemon=True)
    imports.start()
    began = time.perf_counter()
    with ProgressBar() as progress:
        log = read_log(named_file(args.log), args.lenient, bag_options(args), progress)
    seconds = {"read": time.perf_counter() - began}
    imports.join()
    say_notes(log.notes)
    with ProgressBar() as progress, told_compiling() as compiling:
        result = build_map(log, args.method, config, threads=thread_count(args.threads), progress=progress)
    seconds["compile"] = compiling.seconds
    if result.alignment is not None and not result.alignment.found:
        say("note: the walls have no main direction; the map keeps the robot's first heading")
    values = write_run(result, args.output, source=args.log, seconds=seconds)
    say_older(values)
    if args.json:
        print_json({**values, "run": args.output})
    else:
        print("\n".join(summary(values, args.output)))
    return 0


def summary(values: dict[str, Any], folder: str) -> list[str]:
    """The result as text; ``values`` is the content of run.json."""
    counts, seconds, extent = values["counts"], values["seconds"], values["extent_m"]
    lines = [
        f"{values['log']}: {counts['scans']} scans, {values['path_m']:.1f} m of path "
        f"over {extent[0]:.1f} m x {extent[1]:.1f} m, method {values['method']}",
        f"  graph: {counts['nodes']} nodes, {counts['key_nodes']} key-nodes, {counts['loop_edges']} loop edges",
    ]
    if counts["loop_edges"]:
        lines.append(
            f"  chi2: {values['chi2_initial']:.1f} by odometry edges alone, {values['chi2_final']:.1f} optimized "
            f"({counts['optimizations']} times)"
        )
    for turn, done in enumerate(values.get("mended", {}).get("rounds", []), 1):
        lines.append(
            f"  round {turn}: {done['matched']} edges matched again, {done['changed']} changed, {done['accepted']} "
            f"accepted, {done['dropped']} of them loops that went"
        )
    if values["tuning"]:
        tuning = values["tuning"]
        verdict = "consistent" if tuning["consistent"] else "with no phi consistent"
        lines.append(
            f"  tuned: phi = {tuning['phi']:.4g}, {tuning['switched_off']} loops switched off, the map is {verdict} "
            f"(p = {tuning['p_value']:.3g})"
        )
    # Compiling happens within the other stages.
    spent = {name: value for name, value in seconds.items() if name != "compile"}
    parts = ", ".join(f"{name} {value:.1f}" for name, value in spent.items())
    compiled = f"; {seconds['compile']:.1f} of them compiling" if seconds.get("compile") else ""
    lines += [f"  seconds: {sum(spent.values()):.1f} ({parts}{compiled})", f"  map: {folder}/map.png"]
    return lines
