"""Inputs that several commands read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mapmend.errors import InputError

if TYPE_CHECKING:
    from mapmend.graph.pose_graph import PoseGraph


def load_graph(path: str) -> PoseGraph:
    """The graph in a RUN folder or a file; raises InputError that says what is there instead."""
    from mapmend.datasets.cache import named_file
    from mapmend.graph.pose_graph import PoseGraph
    from mapmend.io.info import describe_content
    from mapmend.io.reader import read, read_run

    if Path(path).is_dir():
        graph = read_run(path)[1]
        if graph is None:
            raise InputError(path, "the RUN holds no graph.g2o", "map the log again")
        return graph
    content = read(named_file(path))
    if not isinstance(content, PoseGraph):
        kind = describe_content(content).kind
        raise InputError(path, f"holds no pose graph but a {kind}", "name a RUN, or a g2o or TORO graph with scans")
    return content
