"""``mapmend compare``: methods beside each other on one log."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mapmend.commands.common.console import ProgressBar, print_json, say, say_older, table
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
from mapmend.datasets.cache import named_file
from mapmend.errors import InputError, MapmendError
from mapmend.io.output import check_writable, whole_or_nothing
from mapmend.io.own_files import COMPARISON_PICTURE, RUN_FILES
from mapmend.version import VERSION

COMPARED = ("odometry", "scanmatch", "gmapping", "go", "igo")


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "Writes a RUN folder for each method, compare.png, and run.json with all figures."
    parser.add_argument("log", metavar="LOG", help="a CARMEN log or a ROS bag, as for map")
    parser.add_argument("-o", "--output", metavar="DIR", default="compare", help="folder to write (default: compare)")
    parser.add_argument("--relations", metavar="F", help="true relations, to measure errors against; see eval")
    parser.add_argument(
        "--methods",
        nargs="+",
        choices=METHODS,
        default=list(COMPARED),
        metavar="M",
        help=f"the methods to run (default: {' '.join(COMPARED)})",
    )
    add_settings(parser)
    add_bag(parser)
    add_lenient(parser)
    add_threads(parser)


def run(args: Namespace) -> int:
    """Runs every method in a process of its own, then shows them together; writes one folder, whole or not at all."""
    request = _request(args)
    names = [COMPARISON_PICTURE, *(f"{method}/{name}" for method in args.methods for name in RUN_FILES)]
    check_writable(args.output, names)
    rows: list[dict[str, Any]] = []
    with whole_or_nothing(args.output, names) as output:
        place = output.path
        with ProgressBar() as progress:
            rows += [_run_child({**request, "method": m, "run": str(place / m)}, progress) for m in args.methods]
        for row in rows:
            if "failed" in row:
                row["failed"] = row["failed"].replace(str(place), args.output)
        if all("failed" in row for row in rows):
            raise MapmendError(rows[0]["failed"])
        for note in next(row["notes"] for row in rows if "notes" in row):
            say(f"note: {note}")
        values = {
            "mapmend": VERSION,
            "log": Path(args.log).name,
            "relations": Path(args.relations).name if args.relations else None,
            "seed": request["config"]["seed"],
            "methods": [{name: value for name, value in row.items() if name != "notes"} for row in rows],
        }
        _draw(values, place)
        run_json = output.write_run_json(values)
    say_older(run_json)
    if args.json:
        print_json({**values, "output": args.output})
    else:
        print("\n".join(_lines(values, args.output)))
    return 0


def _request(args: Namespace) -> dict[str, Any]:
    """The requests to the child processes; wrong settings and relations are refused before the work begins."""
    from mapmend.config import to_dict
    from mapmend.io.relations import read_relations
    from mapmend.slam import check_method

    config = map_config(args)
    repeated = {method for method in args.methods if args.methods.count(method) > 1}
    if repeated:
        raise MapmendError(f"--methods names {', '.join(sorted(repeated))} twice")
    for method in args.methods:
        check_method(method, config)
    log, relations = named_file(args.log), named_file(args.relations) if args.relations else None
    if not os.path.exists(log):
        raise InputError(args.log, "is not there", "check the path")
    if relations:
        read_relations(relations)
    return {
        "log": str(log),
        "name": args.log,
        "lenient": args.lenient,
        "bag": asdict(bag_options(args)),
        "config": to_dict(config),
        "threads": thread_count(args.threads),
        "relations": str(relations) if relations else None,
    }


def _run_child(request: dict[str, Any], progress: ProgressBar) -> dict[str, Any]:
    """One method's row; if the method failed, ``failed`` gives the reason."""
    command = [sys.executable, "-m", "mapmend.commands.compare_child", json.dumps(request)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        answer: dict[str, Any] = {}
        try:
            for line in child.stdout:
                answer = json.loads(line)
                if "progress" in answer:
                    stage, done, total = answer["progress"]
                    progress(f"{request['method']}: {stage}", done, total)
            complaint = child.stderr.read().strip().splitlines()
        except BaseException:
            child.kill()
            raise
    if "result" in answer:
        result: dict[str, Any] = answer["result"]
        return result
    died = complaint[-1] if complaint else f"it ended with code {child.returncode}"
    return {"method": request["method"], "failed": answer.get("error", f"{request['method']} died: {died}")}


def _draw(values: dict[str, Any], place: Path) -> None:
    from mapmend.io.nav2 import read_map
    from mapmend.io.reader import read_run
    from mapmend.view.compare_picture import ComparedMap, draw_compared_maps

    maps = []
    for row in values["methods"]:
        if "failed" not in row:
            folder = place / row["method"]
            trajectory = read_run(folder)[0]
            maps.append(ComparedMap(_title(row), read_map(folder / "map.yaml"), trajectory.poses))
    draw_compared_maps(maps, place / COMPARISON_PICTURE)


def _title(row: dict[str, Any]) -> str:
    error = f": {row['translation_mean_m']:.3f} m" if "translation_mean_m" in row else ""
    return f"{row['method']}{error}\n{_verdict(row)}"


def _verdict(row: dict[str, Any]) -> str:
    if row["consistent"] is None:
        return "can't be checked"
    return "consistent" if row["consistent"] else f"inconsistent, p = {row['p_value']:.2g}"


def _lines(values: dict[str, Any], folder: str) -> list[str]:
    """The table as text, and where the rest is."""
    with_errors = values["relations"] is not None
    head = ["method", *(["error [m]", "rotation [deg]"] if with_errors else [])]
    head += ["seconds", "CPU [s]", "memory [MB]", "loops", "check"]
    cells = []
    for row in values["methods"]:
        if "failed" in row:
            cells.append([row["method"], *["-"] * (len(head) - 2), "failed"])
            continue
        line = [row["method"]]
        if with_errors:
            line += [
                f"{row['translation_mean_m']:.4f} +- {row['translation_std_m']:.4f}",
                f"{row['rotation_mean_deg']:.3f}",
            ]
        line += [f"{row['seconds']:.1f}", f"{row['cpu_seconds']:.1f}", f"{row['peak_memory_mb']:.0f}"]
        cells.append([*line, str(row["loop_edges"]), _verdict(row)])
    lines = [table(head, cells), ""]
    lines += [f"{row['method']}: {row['failed']}" for row in values["methods"] if "failed" in row]
    done = [row for row in values["methods"] if "failed" not in row]
    if with_errors:
        used, total = done[0]["used"], done[0]["total"]
        lines.append(f"error: over {used} of {total} relations, mean and standard deviation, poses of the robot")
    lines.append("seconds and memory: of reading, mapping and writing, each method in a process of its own")
    runs = ", ".join(f"{folder}/{row['method']}" for row in done)
    lines.append(f"picture: {folder}/{COMPARISON_PICTURE}, runs: {runs}")
    return lines
