"""``mapmend map``: a log in, a RUN folder out."""

from __future__ import annotations

import time
from argparse import Namespace
from dataclasses import replace
from threading import Thread
from typing import Any

from mapmend.commands.console import ProgressBar, bag_options, print_json, say, say_notes, thread_count, told_compiling
from mapmend.config import Config, read_toml
from mapmend.datasets.cache import named_file
from mapmend.io.output import check_writable
from mapmend.io.read_log import read_log
from mapmend.run_folder import write_run
from mapmend.slam import build_map, check_method


def _import_ahead() -> None:
    """Loads what matching needs while the log is unpacked: both take about as long, on a core each."""
    import mapmend.igo.iterate  # noqa: F401


def run(options: Namespace) -> int:
    """Reads, maps, writes; what can't end well is refused before the work begins."""
    config = configuration(options)
    check_method(options.method, config)
    check_writable(options.output)
    imports = Thread(target=_import_ahead, daemon=True)
    imports.start()
    began = time.perf_counter()
    with ProgressBar() as progress:
        log = read_log(named_file(options.log), options.lenient, bag_options(options), progress)
    seconds = {"read": time.perf_counter() - began}
    imports.join()
    say_notes(log.notes)
    with ProgressBar() as progress, told_compiling() as compiling:
        result = build_map(log, options.method, config, threads=thread_count(options.threads), progress=progress)
    seconds["compile"] = compiling.seconds
    if result.alignment is not None and not result.alignment.found:
        say("note: the walls have no main direction; the map keeps the robot's first heading")
    page = write_run(result, options.output, source=options.log, seconds=seconds)
    if options.json:
        print_json({**page, "run": options.output})
    else:
        print("\n".join(summary(page, options.output)))
    return 0


def summary(page: dict[str, Any], folder: str) -> list[str]:
    """What came of it, for people; ``page`` is run.json's."""
    counts, seconds, extent = page["counts"], page["seconds"], page["extent_m"]
    lines = [
        f"{page['log']}: {counts['scans']} scans, {page['path_m']:.1f} m of path "
        f"over {extent[0]:.1f} m x {extent[1]:.1f} m, method {page['method']}",
        f"  graph: {counts['nodes']} nodes, {counts['key_nodes']} key-nodes, {counts['loop_edges']} loop edges",
    ]
    if counts["loop_edges"]:
        lines.append(
            f"  chi2: {page['chi2_initial']:.1f} by odometry edges alone, {page['chi2_final']:.1f} optimized "
            f"({counts['optimizations']} times)"
        )
    for turn, done in enumerate(page.get("mended", {}).get("rounds", []), 1):
        lines.append(
            f"  round {turn}: {done['matched']} edges matched again, {done['changed']} changed, {done['accepted']} "
            f"accepted, {done['dropped']} of them loops that went"
        )
    if page["tuning"]:
        tuning = page["tuning"]
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


def configuration(options: Namespace) -> Config:
    """The settings that the options ask for."""
    config = read_toml(options.config) if options.config else Config()
    if options.seed is not None:
        config = replace(config, seed=options.seed)
    if options.no_odometry:
        config = replace(config, motion=replace(config.motion, use_odometry=False))
    if options.robust == "auto":
        config = replace(config, loops=replace(config.loops, tune=True))
    if options.align:
        config = replace(config, grid=replace(config.grid, align=True))
    return config
