"""One entry for all files: the format is recognized by the content, not by the name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np

from mapmend.errors import InputError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io._decimals import Float
from mapmend.io.bags.container import bag_kind
from mapmend.io.bags.options import BagOptions
from mapmend.io.carmen import parse_carmen
from mapmend.io.columns import read_columns
from mapmend.io.files import open_text, read_bytes
from mapmend.io.graph_lines import parse_graph
from mapmend.io.nav2 import parse_map, parse_pgm
from mapmend.io.output import finish_interrupted
from mapmend.io.relations import Relations, parse_relations
from mapmend.io.tum import parse_tum
from mapmend.maps import OccupancyMap
from mapmend.parallel import Progress, no_progress
from mapmend.scan import ScanLog
from mapmend.trajectory import Trajectory

__all__ = ["Content", "Picture", "Table", "open_text", "read", "read_bytes", "read_run", "recognise"]

Picture: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
Table: TypeAlias = Float
Content: TypeAlias = ScanLog | PoseGraph | Trajectory | Relations | OccupancyMap | Picture | Table

_LOOKED_AT = 1 << 16  # bytes; more only if all of them are comments or parameters
_MEND = "name a CARMEN log, a ROS bag, a g2o or TORO graph, a TUM trajectory, relations, or a nav2 map"
_LOG_WORDS = ("FLASER", "RLASER", "ROBOTLASER", "ODOM", "PARAM", "SYNC", "RAWLASER", "TRUEPOS", "NMEA")
_GRAPH_WORDS = ("VERTEX", "EDGE", "FIX")
_PAGE_WORDS = ("image:", "resolution:", "origin:", "negate:", "occupied_thresh:", "free_thresh:", "mode:")


def read(
    path: str | Path, lenient: bool = False, bag: BagOptions | None = None, progress: Progress = no_progress
) -> Content:
    """Read a log, ROS bag, graph, trajectory, relations, map, PGM picture or table of numbers, plain or packed.

    ``lenient`` leaves unusable lines of a log out instead of refusing it. ``bag`` chooses topics of a ROS bag. A table
    (such as ``t, x, y, theta``) is returned as an array (n, columns). Raises InputError that names file, line and what
    to do.
    """
    if bag_kind(path) is not None:
        from mapmend.io.bags.read import read_bag

        return read_bag(path, bag, lenient, progress)
    if bag is not None and bag.any_given:
        raise InputError(path, "is no ROS bag", "leave out the options that choose topics and frames of bags")
    data = read_bytes(path)
    kind = recognise(data, path)
    if kind == "log":
        return parse_carmen(data, path, lenient)
    parsers: dict[str, Callable[[bytes, str | Path], Content]] = {
        "graph": parse_graph,
        "trajectory": parse_tum,
        "relations": parse_relations,
        "map": parse_map,
        "picture": parse_pgm,
        "table": _parse_table,
    }
    return parsers[kind](data, path)


def recognise(data: bytes, path: str | Path) -> str:
    """The kind of content: ``log``, ``graph``, ``trajectory``, ``relations``, ``map``, ``picture`` or ``table``.

    The first line that is neither blank nor a comment decides, or a scan farther down. Eight columns are a trajectory
    if the last four are a unit quaternion, otherwise relations. Raises InputError with ``path`` for anything else.
    """
    if not data or data.isspace():
        raise InputError(path, "the file is empty", _MEND)
    if data[:2] in (b"P5", b"P2") and data[2:3].isspace():
        return "picture"
    line = _first_line(data)
    if line is None:
        raise InputError(path, "holds nothing but comments", _MEND)
    word = line.split(None, 1)[0].decode("latin-1")
    kinds = (("log", _LOG_WORDS), ("graph", _GRAPH_WORDS), ("map", _PAGE_WORDS))
    for kind, words in kinds:
        if word.startswith(words):
            return _log_or_graph(data) if kind == "log" and word.startswith("ROBOTLASER") else kind
    if any(mark in data for mark in (b"\nFLASER ", b"\nROBOTLASER1 ")):
        return "log"
    numbers = _numbers(line)
    if numbers is None or b"\0" in data[:_LOOKED_AT]:
        raise InputError(path, "is of no known kind", _MEND)
    if len(numbers) != 8 or b"," in line:
        return "table"
    return "trajectory" if abs(sum(q * q for q in numbers[4:]) - 1.0) < 0.02 else "relations"


def _log_or_graph(data: bytes) -> str:
    """A graph whose first line is a scan is damaged, but it is still a graph."""
    return "graph" if b"\nVERTEX" in data[: _LOOKED_AT * 4] else "log"


def _first_line(data: bytes) -> bytes | None:
    begin = 3 if data.startswith(b"\xef\xbb\xbf") else 0
    while begin < len(data):
        end = data.find(b"\n", begin)
        end = len(data) if end < 0 else end
        line = data[begin:end].strip()
        if line and not line.startswith((b"#", b"---", b"%")):
            return line[:_LOOKED_AT]
        begin = end + 1
    return None


def _numbers(line: bytes) -> list[float] | None:
    try:
        values = [float(word) for word in line.replace(b",", b" ").split()]
    except ValueError:
        return None
    return values if values and b"_" not in line else None


def _parse_table(data: bytes, path: str | Path) -> Table:
    """Numbers in columns, separated by blanks or commas, as many in each line as in the first."""
    plain = data.replace(b",", b" ")
    columns = len((_first_line(plain) or b"").split())
    return read_columns(plain, tuple(f"column {k}" for k in range(1, columns + 1)), path)[0]


def read_run(folder: str | Path) -> tuple[Trajectory, PoseGraph | None]:
    """The trajectory and the graph (None if there is none) of a RUN folder; raises InputError."""
    finish_interrupted(folder)
    trajectory = Path(folder) / "trajectory.tum"
    graph = Path(folder) / "graph.g2o"
    if not trajectory.is_file():
        raise InputError(folder, "is no RUN folder: it holds no trajectory.tum", "name what `mapmend map` wrote")
    read_graph = parse_graph(read_bytes(graph), graph) if graph.is_file() else None
    return parse_tum(read_bytes(trajectory), trajectory), read_graph
