"""Pose graphs as TORO writes them: VERTEX2 and EDGE2, whose information is ordered I11 I12 I22 I33 I13 I23."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.files import read_bytes
from mapmend.io.graph_lines import parse_graph
from mapmend.io.graph_text import write_graph


def read_toro(path: str | Path) -> PoseGraph:
    """Read a TORO graph, as `mapmend.io.g2o.read_g2o` does a g2o graph; raises InputError."""
    return parse_graph(read_bytes(path), path)


def write_toro(target: str | Path | IO[str], graph: PoseGraph) -> None:
    """Write a graph as TORO reads it, with its scans; raises OutputError if the file cannot be written."""
    write_graph(target, graph, "toro")
