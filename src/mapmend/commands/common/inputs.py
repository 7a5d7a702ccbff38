"""Inputs that several commands read."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapmend.graph.pose_graph import PoseGraph


def load_graph(path: str) -> PoseGraph:
    """The graph in a RUN folder, a file or a public data set; raises InputError that says what is there instead."""
    from mapmend.datasets.cache import named_file
    from mapmend.io.read_graph import read_graph

    return read_graph(named_file(path))
