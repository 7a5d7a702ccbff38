"""``mapmend report``: a RUN, or several side by side, as one HTML page to look at and to send."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from mapmend.commands.console import ProgressBar, print_json, say, thread_count, told_compiling
from mapmend.config import Config, read_toml
from mapmend.io.output import check_file_writable, write_whole
from mapmend.report.page import report_page
from mapmend.report.run_data import Run, read_checked

PAGE = "report.html"


def run(options: Namespace) -> int:
    """Checks the graphs of ``options.run`` and ``options.compare`` and writes the page; 0 whatever the verdict."""
    config = read_toml(options.config) if options.config else Config()
    folders = [options.run, *options.compare]
    path = Path(options.output) if options.output else Path(options.run) / PAGE
    if Path(options.run).is_dir():
        check_file_writable(path)
    with ProgressBar() as progress, told_compiling():
        runs = [
            read_checked(folder, config, threads=thread_count(options.threads), progress=progress) for folder in folders
        ]
    for one in runs:
        if one.result is None:
            say(f"note: {one.name} was not checked: {one.unchecked}")
    text = report_page(runs)
    write_whole(path, text)
    if options.json:
        print_json({"report": str(path), "bytes": len(text.encode()), "runs": [_facts(one) for one in runs]})
    else:
        for one in runs:
            print(_line(one))
        print(f"report: {path} ({len(text.encode()) / 1e6:.1f} MB)")
    return 0


def _facts(run: Run) -> dict[str, Any]:
    result = run.result
    return {
        "name": run.name,
        "nodes": len(run.graph),
        "consistent": None if result is None else result.consistent,
        "p_value": None if result is None else result.p_value,
    }


def _line(run: Run) -> str:
    if run.result is None:
        return f"{run.name}: not checked"
    verdict = "consistent" if run.result.consistent else "INCONSISTENT"
    return f"{run.name}: {verdict}, p = {run.result.p_value:.3g}"
