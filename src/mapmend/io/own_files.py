"""Which files of a folder mapmend wrote, so that it may replace them; everything else in the folder belongs to
others."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

from mapmend.errors import OutputError

RUN_FILE = "run.json"
"""The description of an output folder; ``files`` lists, relative to the folder, what mapmend wrote there."""

RUN_FILES = ("trajectory.tum", "graph.g2o", "map.pgm", "map.yaml", "map.png", RUN_FILE)
SIMULATION_FILES = ("log.clf", "truth.tum", "world.png")
TUNE_FILES = ("graph.g2o", "tune.png", RUN_FILE)
COMPARISON_PICTURE, DEMO_PICTURE = "compare.png", "demo.png"

DERIVED_FILES = ("report.html", "check.png", "tune.json")
"""Files that are made from a RUN and put into it; they are out of date when the RUN is replaced."""

_PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
_PNG_HEADER_BYTES, _DOTS_PER_M = 33, 4331  # matplotlib's 110 dots per inch, as view/figures.py asks for
_GENERATOR = b'<meta name="generator" content="mapmend '
_HEAD_BYTES = 4096


def own_files(folder: Path) -> frozenset[str]:
    """The names that mapmend may replace in ``folder``: those that its run.json lists; none if it has no run.json.

    A run.json of version 0.1.0 has no list; its keys show which command wrote it, and so which files. Raises
    OutputError if the run.json is another program's or is damaged.
    """
    path = folder / RUN_FILE
    if not os.path.lexists(path):
        return _files_of_old_tuning(folder)
    run_json = _read_run_json(path)
    names = None if run_json is None or path.is_symlink() else _listed(run_json)
    if names is None:
        what = f"holds a {RUN_FILE} that is not mapmend's"
        raise OutputError(f"{folder}: {what}; name another folder, or move that file away")
    return names | {RUN_FILE}


def is_run(folder: Path) -> bool:
    """Whether a RUN of `mapmend map` lies there, judged by its run.json."""
    run_json = _read_run_json(folder / RUN_FILE)
    names = None if run_json is None else _listed(run_json)
    return names is not None and set(RUN_FILES) <= names | {RUN_FILE}


def older_files(folder: Path, own: frozenset[str], written: Iterable[str]) -> dict[str, str]:
    """Files that fit what ``folder`` held before ``written`` replaces it, with the sha256 of each.

    These are the files of the older output that the new one has no successor for, and those made from a RUN.
    """
    new = set(written)
    replaced = (own & new) - {RUN_FILE}
    if not replaced:
        return {}
    places = {PurePosixPath(name).parent for name in replaced}
    names = (own - new) | {str(place / name) for place in places for name in DERIVED_FILES}
    return {
        name: file_hash(folder / name)
        for name in sorted(names - {RUN_FILE})
        if (folder / name).is_file() and not (folder / name).is_symlink()
    }


def is_older_file(run_json: dict[str, Any], path: Path) -> bool:
    """Whether a file in a folder is still the one that fits what was there before; ``run_json`` is the folder's."""
    older = run_json.get("older_files")
    return isinstance(older, dict) and path.name in older and older[path.name] == file_hash(path)


def file_hash(path: Path) -> str:
    """The sha256 of a file's content, in hexadecimal digits."""
    import hashlib

    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def is_own_content(path: Path) -> bool:
    """Whether mapmend wrote a file outside a listed folder, judged by its beginning or content.

    Known are its pictures with axes (.png), its report (.html) and its graphs (.g2o, .toro, .graph).
    """
    if not path.is_file():
        return False
    if path.suffix in (".g2o", ".toro", ".graph"):
        from mapmend.io.laser_scans import EXACT_MARK

        return EXACT_MARK in path.read_bytes()
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    return _is_own_picture(head) if path.suffix == ".png" else _GENERATOR in head


def _is_own_picture(head: bytes) -> bool:
    """A picture by `mapmend.view.figures.save_figure`: its density, then the pixels, and no program's name."""
    density = _DOTS_PER_M.to_bytes(4, "big") * 2 + b"\x01"
    after = head[_PNG_HEADER_BYTES:]
    begins = b"\x00\x00\x00\x09pHYs" + density
    return head.startswith(_PNG_BEGIN) and after.startswith(begins) and after[len(begins) + 8 :][:4] == b"IDAT"


def _read_run_json(path: Path) -> dict[str, Any] | None:
    try:
        run_json = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return run_json if isinstance(run_json, dict) and isinstance(run_json.get("mapmend"), str) else None


def _listed(run_json: dict[str, Any]) -> frozenset[str] | None:
    """The names that a run.json lists, or those that version 0.1.0 wrote with it; None if it is another program's."""
    if "files" in run_json:
        names = run_json["files"]
        return frozenset(names) if isinstance(names, list) and all(map(is_name, names)) else None
    rows = run_json.get("methods")
    if isinstance(rows, list):
        methods = [row["method"] for row in rows if isinstance(row, dict) and is_name(row.get("method"))]
        runs = [f"{method}/{name}" for method in methods for name in RUN_FILES]
        return frozenset(runs) | ({DEMO_PICTURE, *SIMULATION_FILES} if "world" in run_json else {COMPARISON_PICTURE})
    if {"method", "counts", "chi2_final"} <= run_json.keys():
        return frozenset(RUN_FILES)
    if {"world", "seed", "scans", "path_m"} <= run_json.keys():
        return frozenset(SIMULATION_FILES)
    return None


def _files_of_old_tuning(folder: Path) -> frozenset[str]:
    """Version 0.1.0 wrote no run.json beside a tuned graph and its picture; only both together are recognized."""
    pair = ("tune.png", "graph.g2o")
    return frozenset(pair) if all(is_own_content(folder / name) for name in pair) else frozenset()


def is_name(name: object) -> bool:
    """Whether this names a file below a folder and leads nowhere else."""
    if not isinstance(name, str) or not name or "\0" in name:
        return False
    return not name.startswith("/") and all(part not in ("", ".", "..") for part in name.split("/"))
