"""``mapmend view``: a RUN replayed in rerun, in its window or saved to a file."""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from mapmend.commands.common.console import print_json
from mapmend.errors import InputError, MapmendError
from mapmend.io.output import check_file_writable, write_whole


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "Needs rerun: pip install 'mapmend[view]'."
    parser.add_argument("run", metavar="RUN", help="the folder that `mapmend map` wrote")
    parser.add_argument("--save", metavar="FILE", help="write a recording (.rrd) and open no window")


def run(args: Namespace) -> int:
    """Replays ``args.run``; a missing screen or package is reported before anything is read."""
    from mapmend.io.nav2 import read_map
    from mapmend.io.reader import read_run
    from mapmend.report.run_data import read_run_json
    from mapmend.view.rerun_recording import check_installed, record, rrd_bytes, show

    check_installed()
    if args.save:
        check_file_writable(args.save, [args.run])
    elif not _has_screen():
        raise MapmendError("there is no screen to open rerun on; give --save run.rrd and open that file elsewhere")
    trajectory, graph = read_run(args.run)
    if graph is None:
        raise InputError(args.run, "the RUN holds no graph.g2o", "map the log again")
    run_json = read_run_json(args.run)
    grid = read_map(Path(args.run) / "map.yaml")
    recording = record(trajectory, graph, grid, run_json.get("key_nodes") or [], Path(args.run).resolve().name)
    told = {"scans": len(trajectory), "nodes": len(graph)}
    if not args.save:
        show(recording)
        if args.json:
            print_json(told)
        return 0
    content = rrd_bytes(recording)
    write_whole(args.save, content)
    if args.json:
        print_json({**told, "recording": args.save, "bytes": len(content)})
    else:
        print(f"recording: {args.save} ({len(content) / 1e6:.1f} MB); open it with: rerun {args.save}")
    return 0


def _has_screen() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
