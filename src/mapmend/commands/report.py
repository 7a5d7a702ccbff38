"""``mapmend report``: a RUN, or several side by side, as one HTML page to look at and to send."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmend.commands.common.console import ProgressBar, print_json, say, told_compiling
from mapmend.commands.common.options import add_config, add_threads, read_config, thread_count
from mapmend.io.output import check_file_writable, check_own_writable, write_own, write_whole

if TYPE_CHECKING:
    from mapmend.report.run_data import Run

PAGE = "report.html"


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "The page holds all of its data, opens in any browser, and loads nothing from the network."
    parser.add_argument("run", metavar="RUN", help="the folder that `mapmend map` wrote")
    parser.add_argument("--compare", metavar="RUN", nargs="+", default=[], help="other runs to show beside it")
    parser.add_argument("-o", "--output", metavar="FILE", help="the page to write (default: RUN/report.html)")
    add_config(parser, "settings of the check, in TOML")
    add_threads(parser)


def run(args: Namespace) -> int:
    """Checks the graphs of ``args.run`` and ``args.compare`` and writes the page; returns 0 for any verdict."""
    from mapmend.report.page import report_page
    from mapmend.report.run_data import read_checked

    config = read_config(args)
    folders = [args.run, *args.compare]
    path = Path(args.output) if args.output else Path(args.run) / PAGE
    if args.output:
        check_file_writable(path, folders)
    elif Path(args.run).is_dir():
        check_own_writable(path)
    with ProgressBar() as progress, told_compiling():
        runs = [
            read_checked(folder, config, threads=thread_count(args.threads), progress=progress) for folder in folders
        ]
    for one in runs:
        if one.result is None:
            say(f"note: {one.name} was not checked: {one.unchecked}")
        if one.has_older_tuning:
            say(f"note: {one.name}: its tune.json is of an older map and is left out; tune again")
    text = report_page(runs)
    (write_whole if args.output else write_own)(path, text)
    if args.json:
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
