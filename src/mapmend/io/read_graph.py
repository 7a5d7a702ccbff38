"""A graph or a trajectory from a file or a RUN folder; for other content, the error says what the file holds."""

from __future__ import annotations

from pathlib import Path

from mapmend.errors import InputError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.info import describe_content
from mapmend.io.reader import read, read_run
from mapmend.trajectory import Trajectory


def read_graph(path: str | Path) -> PoseGraph:
    """The pose graph in a g2o or TORO file, plain or packed, or in a RUN folder; raises InputError."""
    if Path(path).is_dir():
        graph = read_run(path)[1]
        if graph is None:
            raise InputError(path, "the RUN holds no graph.g2o", "map the log again")
        return graph
    content = read(path)
    if not isinstance(content, PoseGraph):
        kind = describe_content(content).kind
        raise InputError(path, f"holds no pose graph but a {kind}", "name a RUN, or a g2o or TORO graph with scans")
    return content


def read_trajectory(path: str | Path) -> Trajectory:
    """The trajectory in a TUM file, plain or packed, or in a RUN folder; raises InputError."""
    if Path(path).is_dir():
        return read_run(path)[0]
    content = read(path)
    if not isinstance(content, Trajectory):
        kind = describe_content(content).kind
        raise InputError(path, f"holds no trajectory but a {kind}", "name a RUN or a TUM trajectory")
    return content
