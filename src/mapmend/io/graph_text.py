"""Pose graphs into text: g2o's lines or TORO's."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import numpy as np

from mapmend.graph.pose_graph import PoseGraph
from mapmend.io._decimals import Bool, Int
from mapmend.io.graph_lines import LOOP_MARK, SEQUENTIAL_MARK
from mapmend.io.laser_scans import EXACT_MARK
from mapmend.io.laser_text import numbers, robot_laser_lines
from mapmend.io.output import write_whole
from mapmend.scan import Scans

G2O = ("VERTEX_SE2", "EDGE_SE2", (0, 1, 2, 4, 5, 8))  # I11 I12 I13 I22 I23 I33
TORO = ("VERTEX2", "EDGE2", (0, 1, 4, 8, 2, 5))  # I11 I12 I22 I33 I13 I23


def write_graph(target: str | Path | IO[str], graph: PoseGraph, words: tuple[str, str, tuple[int, ...]]) -> None:
    """Write a graph to a file, whole or not at all, or to a text stream."""
    text = graph_text(graph, words)
    if isinstance(target, str | Path):
        write_whole(target, text)
    else:
        target.write(text.decode())


def graph_text(graph: PoseGraph, words: tuple[str, str, tuple[int, ...]]) -> bytes:
    """The file's content: vertices each followed by its scan, then the edges, all to the last bit."""
    vertex_word, edge_word, order = words
    lines = [EXACT_MARK]
    scan_lines = _scan_lines(graph)
    ids = graph.ids.tolist()
    for k, pose in enumerate(graph.poses):
        lines.append(f"{vertex_word} {ids[k]} {numbers(pose)}".encode())
        if k in scan_lines:
            lines.append(scan_lines[k])
    if graph.fixed and graph.fixed != (0,):
        lines += [f"FIX {ids[k]}".encode() for k in graph.fixed]
    in_loops: bool | None = None
    sections = not np.array_equal(_loops_by_ids(graph), graph.is_loop)
    information = graph.information.reshape(-1, 9)[:, order]
    named = graph.ids[graph.edges].tolist()
    for (i, j), loop, z, six in zip(named, graph.is_loop.tolist(), graph.measurements, information, strict=True):
        if sections and loop is not in_loops:
            in_loops = loop
            lines.append(LOOP_MARK if loop else SEQUENTIAL_MARK)
        lines.append(f"{edge_word} {i} {j} {numbers(z)} {numbers(six)}".encode())
    return b"\n".join(lines) + b"\n"


def _loops_by_ids(graph: PoseGraph) -> Bool:
    """What a reader takes for loops without being told."""
    ids: Int = graph.ids[graph.edges]
    return (np.abs(ids[:, 0] - ids[:, 1]) != 1) & (np.abs(graph.edges[:, 0] - graph.edges[:, 1]) != 1)


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
