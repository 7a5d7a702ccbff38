"""Pose graphs to text: g2o's lines or TORO's."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np

from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.formats import GRAPH_FORMATS, graph_format_of
from mapmend.io.graph_lines import OTHERWISE_MARK, loops_by_ids
from mapmend.io.laser_scans import EXACT_MARK
from mapmend.io.laser_text import numbers, robot_laser_lines
from mapmend.io.output import write_whole
from mapmend.scan import Scans

# By format: the keywords of a node and an edge, and the order of the information's entries (row-major).
_LINES = {
    "g2o": ("VERTEX_SE2", "EDGE_SE2", (0, 1, 2, 4, 5, 8)),  # I11 I12 I13 I22 I23 I33
    "toro": ("VERTEX2", "EDGE2", (0, 1, 4, 8, 2, 5)),  # I11 I12 I22 I33 I13 I23
}


def write_graph(target: str | Path | IO[str], graph: PoseGraph, form: str = "") -> None:
    """Write a graph to a file, whole or not at all, or to a text stream.

    ``form``: ``g2o`` or ``toro``; by default that of the file's name (.g2o, .toro, .graph). Raises OutputError where it
    can't be written, and MapmendError where neither says the format.
    """
    form = form or (isinstance(target, str | Path) and graph_format_of(target)) or ""
    if form not in GRAPH_FORMATS:
        raise MapmendError(f"{target}: the name is none of a graph's (.g2o, .toro, .graph); name the format")
    text = graph_text(graph, form)
    if isinstance(target, str | Path):
        write_whole(target, text)
    else:
        target.write(text.decode())


def graph_text(graph: PoseGraph, form: str) -> bytes:
    """The file's content: vertices each followed by its scan, then the edges, all to the last bit; comments last."""
    vertex_word, edge_word, order = _LINES[form]
    lines = []
    scan_lines = _scan_lines(graph)
    ids = graph.ids.tolist()
    for k, pose in enumerate(graph.poses):
        lines.append(f"{vertex_word} {ids[k]} {numbers(pose)}".encode())
        if k in scan_lines:
            lines.append(scan_lines[k])
    information = graph.information.reshape(-1, 9)[:, order]
    for (i, j), z, six in zip(graph.ids[graph.edges].tolist(), graph.measurements, information, strict=True):
        lines.append(f"{edge_word} {i} {j} {numbers(z)} {numbers(six)}".encode())
    # Other readers stop at a line that they do not know: GTSAM's reads no edge after it.
    if graph.fixed and graph.fixed != (0,):
        lines += [f"FIX {ids[k]}".encode() for k in graph.fixed]
    lines.append(EXACT_MARK)
    otherwise = np.flatnonzero(loops_by_ids(graph.ids, graph.edges) != graph.is_loop)
    if len(otherwise):
        lines.append(OTHERWISE_MARK + b" ".join(b"%d" % k for k in otherwise.tolist()) + b" of %d" % len(graph.edges))
    return b"\n".join(lines) + b"\n"


def _scan_lines(graph: PoseGraph) -> dict[int, bytes]:
    """The ROBOTLASER line of each node that has a scan or a stamp; one without readings only carries the stamp."""
    n = len(graph)
    scans = graph.scans
    if scans is None:
        scans = Scans(np.zeros(0, np.float32), np.zeros(n + 1, np.int64), np.zeros(n, np.int32), ())
    written = np.diff(scans.offsets) > 0
    if graph.stamps_s is not None:
        written |= np.isfinite(graph.stamps_s)
    rows = np.flatnonzero(written)
    return dict(zip(rows.tolist(), robot_laser_lines(scans, graph.poses, graph.stamps_s, rows), strict=True))
