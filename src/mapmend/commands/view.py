"""``mapmend view``: a RUN replayed in rerun, in its window or saved to a file."""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from pathlib import Path

from mapmend.commands.console import print_json
from mapmend.errors import InputError, MapmendError
from mapmend.io.nav2 import read_map
from mapmend.io.output import check_file_writable, write_whole
from mapmend.io.reader import read_run
from mapmend.report.run_data import read_page
from mapmend.view.rerun_recording import check_installed, record, rrd_bytes, show


def run(options: Namespace) -> int:
    """Replays ``options.run``; what is missing, a screen included, is told before anything is read."""
    check_installed()
    if options.save:
        check_file_writable(options.save)
    elif not _has_screen():
        raise MapmendError("there is no screen to open rerun on; give --save run.rrd and open that file elsewhere")
    trajectory, graph = read_run(options.run)
    if graph is None:
        raise InputError(options.run, "the RUN holds no graph.g2o", "map the log again")
    page = read_page(options.run)
    grid = read_map(Path(options.run) / "map.yaml")
    recording = record(trajectory, graph, grid, page.get("key_nodes") or [], Path(options.run).resolve().name)
    told = {"scans": len(trajectory), "nodes": len(graph)}
    if not options.save:
        show(recording)
        if options.json:
            print_json(told)
        return 0
    content = rrd_bytes(recording)
    write_whole(options.save, content)
    if options.json:
        print_json({**told, "recording": options.save, "bytes": len(content)})
    else:
        print(f"recording: {options.save} ({len(content) / 1e6:.1f} MB); open it with: rerun {options.save}")
    return 0


def _has_screen() -> bool:
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
