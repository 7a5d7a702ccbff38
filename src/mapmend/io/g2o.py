"""Pose graphs as g2o writes them: VERTEX_SE2, EDGE_SE2, FIX, and a ROBOTLASER1 line after a vertex for its scan."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.files import read_bytes
from mapmend.io.graph_lines import parse_graph
from mapmend.io.graph_text import write_graph


def read_g2o(path: str | Path) -> PoseGraph:
    """Read a 2D pose graph, plain or compressed, with its scans and stamps if it has any.

    Edges between consecutive ids, or between vertices next to each other in the file, are odometry, all others loops.
    TORO's lines are read too. Raises InputError that names file, line and what to do.
    """
    return parse_graph(read_bytes(path), path)


def write_g2o(target: str | Path | IO[str], graph: PoseGraph) -> None:
    """Write a graph to a file (whole or not at all) or text stream; read back, it is the same to the last bit.

    Raises OutputError if the file cannot be written.
    """
    write_graph(target, graph, "g2o")
