"""How the time of `mapmend map` is spent: by stage, and inside matching by function; and its peak memory.

The stages are those of a process without a profiler, after a warm-up that fills the kernel cache. The functions are
those of a second pass through the front end in one process under cProfile, which slows down Python but not Numba: use
its shares, not its seconds. Kernels are called from the functions named and count as their own time.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from _measure import MAPMEND, data_parser, log_path, markdown, medians, run

IMPORTS = """
import time
for name in ("mapmend.slam", "numba.core.event", "mapmend.front_end.builder", "mapmend.view.map_picture"):
    began = time.perf_counter()
    __import__(name)
    print(time.perf_counter() - began)
"""
STAGES = ("read", "match", "map", "write")
MOST = 15


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--log", default="intel", metavar="NAME", help="which log of DATA (default: intel)")
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs of the process (default: 5)")
    parser.add_argument("--functions", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    path = log_path(options.data, options.log)
    if options.functions:
        print(functions(path))
        return
    print(stages(path, options.runs), flush=True)
    # A child of its own, so that the profiler's memory and caches are nobody else's.
    command = [sys.executable, __file__, options.data, "--log", options.log, "--functions"]
    print(run(command).output, end="")


def stages(path: Path, runs: int) -> str:
    """The seconds of each stage, medians of each over the runs."""
    pages, children = [], []
    with tempfile.TemporaryDirectory() as folder:
        command = [MAPMEND, "map", str(path), "-o", f"{folder}/run", "--json"]
        run(command)
        for _ in range(runs):
            children.append(run(command))
            pages.append(json.loads(children[-1].output)["seconds"])
    start_s = median([run([sys.executable, "-c", "pass"]).wall_s for _ in range(runs)])
    imports = [[float(line) for line in run([sys.executable, "-c", IMPORTS]).output.split()] for _ in range(runs)]
    base_s, numba_s, front_end_s, picture_s = (median(column) for column in zip(*imports, strict=True))
    seconds = {name: median([page[name] for page in pages]) for name in STAGES}
    whole = medians(children)
    # The front end's own import happens within "match".
    known_s = start_s + base_s + numba_s + picture_s + sum(seconds.values())
    rows = [
        ("start of Python", f"{start_s:.2f}"),
        ("import: NumPy, mapmend", f"{base_s:.2f}"),
        ("import: Numba", f"{numba_s:.2f}"),
        ("import: the picture", f"{picture_s:.2f}"),
        *((name, f"{seconds[name]:.2f}") for name in STAGES),
        ("the rest", f"{whole.wall_s - known_s:.2f}"),
        ("**whole process**", f"**{whole.wall_s:.2f}**"),
        ("of match: import of the front end", f"{front_end_s:.2f}"),
        ("CPU", f"{whole.cpu_s:.2f}"),
        ("peak memory [MB]", f"{whole.peak_mb:.0f}"),
    ]
    return markdown(("stage", f"seconds, median of {runs}"), rows)


def functions(path: Path) -> str:
    """The functions with the most time of their own in the front end's second pass, as a table."""
    from mapmend.config import Config
    from mapmend.front_end.builder import FrontEnd
    from mapmend.io.read_log import read_log

    log = read_log(path)
    FrontEnd(log.scans.geometries, Config()).run(log)
    began = time.perf_counter()
    FrontEnd(log.scans.geometries, Config()).run(log)
    plain_s = time.perf_counter() - began
    front_end = FrontEnd(log.scans.geometries, Config())
    profile = cProfile.Profile()
    profile.runcall(front_end.run, log)
    entries = pstats.Stats(profile).get_stats_profile()
    total_s = entries.total_tt
    worst = sorted(entries.func_profiles.items(), key=lambda item: -item[1].tottime)[:MOST]
    rows = [
        (
            f"`{place(entry.file_name, entry.line_number, name)}`",
            str(entry.ncalls),
            f"{entry.tottime:.2f}",
            f"{100.0 * entry.tottime / total_s:.0f} %",
            f"{entry.cumtime:.2f}",
        )
        for name, entry in worst
    ]
    head = ("function", "calls", "own seconds", "share", "with what it calls")
    text = f"matching, warm: {plain_s:.2f} s plain, {total_s:.2f} s under the profiler"
    return f"\n{text}\n\n{markdown(head, rows)}"


def place(file: str, line: int, name: str) -> str:
    """A function's name with its place in the package, not on this machine."""
    parts = Path(file).parts
    if "mapmend" in parts:
        last = len(parts) - 1 - parts[::-1].index("mapmend")
        return f"{'/'.join(parts[last + 1 :])}:{line} {name}"
    return name if file == "~" else f"{Path(file).name}:{line} {name}"


if __name__ == "__main__":
    main()
