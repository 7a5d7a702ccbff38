"""Conversion of files from one format to another: what is converted, what is lost, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mapmend.errors import InputError, MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io._decimals import Float
from mapmend.io.bags.container import bag_kind
from mapmend.io.bags.options import BagOptions
from mapmend.io.bags.write import MCAP, SQLITE, write_bag
from mapmend.io.carmen import write_carmen
from mapmend.io.formats import BAG_FILE, GRAPH_FORMATS, LOG_FORMATS, TRAJECTORY_FORMATS, format_of
from mapmend.io.graph_text import write_graph
from mapmend.io.kitti import COLUMNS, read_kitti, write_kitti
from mapmend.io.output import check_file_writable
from mapmend.io.reader import read, read_run
from mapmend.io.tum import write_tum
from mapmend.scan import Note, ScanLog
from mapmend.trajectory import Trajectory


@dataclass(frozen=True)
class UnstampedPoses:
    """Poses without stamps, shape (n, 3), as in a KITTI file."""

    poses: Float


Convertible = ScanLog | PoseGraph | Trajectory | UnstampedPoses


@dataclass(frozen=True)
class Converted:
    """What was read and written: ``count`` scans, nodes or poses; ``lost`` lists what the new file cannot hold.

    ``notes`` describe what was odd about a graph that was read.
    """

    kind: str
    format: str
    count: int
    lost: tuple[str, ...]
    notes: tuple[Note, ...] = ()


def convert(
    source: str | Path,
    target: str | Path,
    to: str | None = None,
    *,
    bag: BagOptions | None = None,
    stamps: str | Path | None = None,
    lenient: bool = False,
) -> Converted:
    """Read one file and write it as another, in the format ``to`` or that of the target's name.

    ``stamps``: a file with one time (s) on each line, for poses that have none. Raises InputError with the reason if
    the new format cannot hold the content, OutputError if it cannot be written.
    """
    form = to or format_of(target)
    if form == "sqlite3" and Path(target).suffix == BAG_FILE:
        raise MapmendError(f"{target}: an .mcap file holds no sqlite3; name a folder")
    if not Path(target).is_dir():
        check_file_writable(target, [source] if stamps is None else [source, stamps])
    content = _load(source, form, bag, lenient)
    if stamps is not None:
        content = _stamped(content, stamps, source)
    kind = _kind(content)
    losses: list[str] = []
    if form in LOG_FORMATS:
        log, losses = as_log(content, source)
        _LOG_WRITERS[form](target, log)
        count = len(log)
    elif form in GRAPH_FORMATS:
        graph = as_graph(content, source)
        write_graph(target, graph, form)
        count = len(graph)
    else:
        count, losses = _write_path(content, form, source, target)
    if bag_kind(source) is not None and form in LOG_FORMATS:
        losses.append("other topics of the bag, intensities and the time within a sweep")
    notes = content.notes if isinstance(content, PoseGraph) else ()
    return Converted(kind, form, count, tuple(losses), notes)


_LOG_WRITERS: dict[str, Callable[[str | Path, ScanLog], None]] = {
    "carmen": write_carmen,
    "mcap": lambda target, log: write_bag(target, log, MCAP),
    "sqlite3": lambda target, log: write_bag(target, log, SQLITE),
}


def _load(source: str | Path, form: str, bag: BagOptions | None, lenient: bool) -> Convertible:
    """The content of the source; of a RUN its trajectory if the target is one, otherwise its graph."""
    place = Path(source)
    if place.is_dir() and bag_kind(place) is None:
        trajectory, graph = read_run(place)
        if form in TRAJECTORY_FORMATS:
            return trajectory
        if graph is None:
            raise InputError(source, "the RUN holds no graph.g2o", "map the log again")
        return graph
    content = read(source, lenient, bag)
    if isinstance(content, ScanLog | PoseGraph | Trajectory):
        return content
    if isinstance(content, np.ndarray) and content.dtype == np.float64 and content.shape[1] == COLUMNS:
        return UnstampedPoses(read_kitti(source))
    raise InputError(source, "holds no log, graph or trajectory", "name a CARMEN log, a bag, g2o, TORO, TUM or KITTI")


def _kind(content: Convertible) -> str:
    kinds = {ScanLog: "log", PoseGraph: "graph", Trajectory: "trajectory", UnstampedPoses: "trajectory without stamps"}
    return kinds[type(content)]


def _stamped(content: Convertible, stamps: str | Path, source: str | Path) -> Convertible:
    """Poses or nodes with times from a separate file."""
    table = read(stamps)
    if not isinstance(table, np.ndarray) or table.dtype != np.float64 or table.shape[1] != 1:
        raise InputError(stamps, "holds no column of times", "give one time in seconds on each line")
    times: Float = table[:, 0].astype(np.float64)
    poses = content.poses if isinstance(content, UnstampedPoses | PoseGraph) else None
    if poses is None:
        raise InputError(source, "has stamps of its own", "leave out --stamps")
    if len(times) != len(poses):
        raise InputError(stamps, f"holds {len(times)} times for {len(poses)} poses", f"give those of {source}")
    return replace(content, stamps_s=times) if isinstance(content, PoseGraph) else Trajectory(times, poses)


def as_log(content: Convertible, source: str | Path) -> tuple[ScanLog, list[str]]:
    """A log: a graph's nodes are its scans, their poses its odometry. Raises InputError without scans."""
    if isinstance(content, ScanLog):
        return content, []
    if not isinstance(content, PoseGraph):
        raise InputError(source, "holds poses but no scans, and a log is made of scans", "write it as tum or kitti")
    graph = content
    if graph.scans is None:
        what = "its nodes carry no scans, and a log is made of scans"
        raise InputError(source, what, "write it as g2o, toro, tum or kitti")
    rows = np.flatnonzero(np.diff(graph.scans.offsets) > 0)
    stamps = np.full(len(graph), np.nan) if graph.stamps_s is None else graph.stamps_s
    has_stamps = bool(np.isfinite(stamps[rows]).all())
    times = stamps[rows] if has_stamps else np.arange(len(rows), dtype=np.float64)
    lost = [f"{len(graph.edges)} edges; the nodes' poses are written as odometry"]
    if len(rows) < len(graph):
        lost.append(f"{len(graph) - len(rows)} nodes without a scan")
    return ScanLog(graph.scans.select(rows), times, graph.poses[rows].copy(), has_stamps, str(source)), lost


def as_graph(content: Convertible, source: str | Path) -> PoseGraph:
    """A graph; raises InputError for content without edges."""
    if isinstance(content, PoseGraph):
        return content
    if isinstance(content, ScanLog):
        mend = "mapmend map makes a graph of a log (--method odometry: of its odometry alone)"
        raise InputError(source, "is a log: it has no edges, and no uncertainty to give them", mend)
    mend = "a trajectory can be written as tum or kitti"
    raise InputError(source, "is a trajectory: it has no edges, and no uncertainty to give them", mend)


def _write_path(content: Convertible, form: str, source: str | Path, target: str | Path) -> tuple[int, list[str]]:
    """Poses as TUM or KITTI: a log's odometry, a graph's nodes, a trajectory."""
    lost: list[str] = []
    if isinstance(content, ScanLog):
        if not content.has_odometry:
            raise InputError(source, "has no odometry, so no trajectory yet", "mapmend map makes one")
        lost.append("the scans; the poses are the raw odometry")
        stamps = content.stamps_s if content.has_stamps else None
        poses = content.odometry
    elif isinstance(content, PoseGraph):
        lost.append(f"{len(content.edges)} edges" + ("" if content.scans is None else " and the scans"))
        poses, stamps = content.poses, content.stamps_s
    else:
        poses, stamps = content.poses, content.stamps_s if isinstance(content, Trajectory) else None
    if form == "kitti":
        write_kitti(target, poses)
        return len(poses), lost + (["the stamps"] if stamps is not None else [])
    if stamps is None:
        raise InputError(source, "its poses have no stamps, and TUM needs them", "give their times with --stamps FILE")
    timed = np.isfinite(stamps)
    if not timed.any():
        raise InputError(source, "no node has a stamp, and TUM needs them", "give their times with --stamps FILE")
    if not timed.all():
        lost.append(f"{np.count_nonzero(~timed)} nodes without a stamp")
    write_tum(target, stamps[timed], poses[timed])
    return int(timed.sum()), lost
