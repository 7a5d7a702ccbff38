"""Shared code of the benchmarks: the data folder, child processes with their time and memory, Markdown tables.

Nothing here imports mapmend or NumPy: on Linux a child's peak memory is never less than its parent's was when the child
started, so a process that measures children must itself stay small.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

MAPMEND = str(Path(sys.executable).with_name("mapmend"))
MB_PER_RSS_UNIT = 1.0 / 1024.0 if sys.platform != "darwin" else 1.0 / 1024.0**2


@dataclass(frozen=True)
class Run:
    """One child process: its seconds by the clock and by the processor, its peak memory, and what it printed."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    output: str


def data_parser(description: str | None) -> argparse.ArgumentParser:
    """A parser with DATA, the folder that holds ``logs/`` and ``relations/``."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "data",
        nargs="?",
        metavar="DATA",
        default=os.environ.get("MAPMEND_DATA"),
        help="the folder with logs/ and relations/ (default: what MAPMEND_DATA names)",
    )
    return parser


def log_path(data: str | None, name: str) -> Path:
    """The log with this name in the data folder; ends the program if there is none."""
    path = Path(data or "") / "logs" / f"{name}.clf.bz2"
    if not data or not path.is_file():
        stop(f"no {path}; name the folder with the recordings, or set MAPMEND_DATA")
    return path


def relations_path(data: str | None, name: str) -> Path:
    """The true relations that belong to that log."""
    path = Path(data or "") / "relations" / f"{name}.relations"
    if not path.is_file():
        stop(f"no {path}; relations lie beside the logs")
    return path


def stop(what: str) -> NoReturn:
    raise SystemExit(f"{Path(sys.argv[0]).name}: {what}")


def run(command: Sequence[str], **environment: str) -> Run:
    """Runs a child to its end; if it fails, ends the program with the child's message."""
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as printed:
        began = time.perf_counter()
        child = subprocess.Popen(list(command), stdout=printed, stderr=said, env={**os.environ, **environment})
        _, status, usage = os.wait4(child.pid, 0)
        wall_s = time.perf_counter() - began
        child.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        printed.seek(0)
        if child.returncode:
            stop(f"{' '.join(command)} failed: {said.read().strip()}")
        output = printed.read()
    return Run(wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * MB_PER_RSS_UNIT, output)


def peak_mb() -> float:
    """This process's own peak memory."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MB_PER_RSS_UNIT


def medians(runs: Sequence[Run]) -> Run:
    """The median of each number, and the last output."""
    walls, cpus, peaks = zip(*((r.wall_s, r.cpu_s, r.peak_mb) for r in runs), strict=True)
    return Run(statistics.median(walls), statistics.median(cpus), statistics.median(peaks), runs[-1].output)


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table: the first column to the left, the others to the right."""
    rule = ["---"] + ["---:"] * (len(head) - 1)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, rule, *rows))
