"""What a file holds, and what is odd about it: the content of ``mapmend info``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mapmend.errors import InputError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.bags.container import bag_kind
from mapmend.io.bags.describe import describe_bag, frame_line, topic_line
from mapmend.io.bags.options import BagOptions
from mapmend.io.reader import Content, read, read_run
from mapmend.io.relations import Relations
from mapmend.maps import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from mapmend.scan import LaserGeometry, ScanLog, Scans
from mapmend.trajectory import Trajectory, path_length_m

_MOST_LINES = 40


@dataclass(frozen=True)
class FileInfo:
    """``kind`` and ``facts`` of a file, keys with their units; ``notes`` say what is odd. Facts are ready for JSON."""

    path: str
    kind: str
    facts: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """One flat object for ``--json``."""
        return {"path": self.path, "kind": self.kind, **self.facts, "notes": list(self.notes)}

    def lines(self) -> list[str]:
        """The same as text: angles in degrees, one fact on each line."""
        lines = [f"{self.path}: {self.kind}"]
        for key, value in self.facts.items():
            if key in _LISTS:
                lines += _list_lines(key, value)
            else:
                lines.append(f"  {_label(key)}: {_shown(key, value)}")
        return lines + [f"  note: {note}" for note in self.notes]


def _list_lines(key: str, rows: list[dict[str, Any]]) -> list[str]:
    """One line for each of the first few; a laser whose speed varies has a new geometry with every scan."""
    lines = [_LISTS[key](row) for row in rows[:_MOST_LINES]]
    return lines + ([f"  {len(rows) - _MOST_LINES} more {key}"] if len(rows) > _MOST_LINES else [])


def describe(path: str | Path, lenient: bool = False, bag: BagOptions | None = None) -> FileInfo:
    """Read a file, a ROS bag or a RUN folder, and say what it holds; raises InputError if it cannot be read."""
    if bag_kind(path) is not None:
        return _describe_bag(path, lenient, bag)
    if Path(path).is_dir() and (Path(path) / "run.json").is_file():
        trajectory, graph = read_run(path)
        facts = {"trajectory": _trajectory_facts(trajectory), "graph": None if graph is None else _graph_facts(graph)}
        return FileInfo(str(path), "run", facts, () if graph is None else tuple(map(str, graph.notes)))
    return describe_content(read(path, lenient, bag), path)


def _describe_bag(path: str | Path, lenient: bool, bag: BagOptions | None) -> FileInfo:
    """A bag's topics and frames; and the facts of its log, or the reason why there is none yet."""
    facts, notes = describe_bag(path)
    try:
        log = describe_content(read(path, lenient, bag), path)
    except InputError as error:
        return FileInfo(str(path), "bag", facts, (*notes, f"no log yet: {error.what}; {error.mend}"))
    return FileInfo(str(path), "bag", {**facts, **log.facts}, log.notes)


def describe_content(content: Content, path: str | Path = "") -> FileInfo:
    """The same for content that has already been read."""
    place = str(path)
    if isinstance(content, ScanLog):
        return FileInfo(place, "log", _log_facts(content), tuple(map(str, content.notes)) + _log_notes(content))
    if isinstance(content, PoseGraph):
        return FileInfo(place, "graph", _graph_facts(content), _graph_notes(content))
    if isinstance(content, Trajectory):
        return FileInfo(place, "trajectory", _trajectory_facts(content))
    if isinstance(content, Relations):
        return FileInfo(place, "relations", _relations_facts(content))
    if isinstance(content, OccupancyMap):
        return FileInfo(place, "map", _map_facts(content))
    if isinstance(content, np.ndarray) and content.dtype == np.uint8:
        return FileInfo(place, "picture", {"rows": content.shape[0], "columns": content.shape[1]})
    if isinstance(content, np.ndarray):
        return FileInfo(place, "table", {"rows": content.shape[0], "columns": content.shape[1]})
    raise InputError(path, "holds nothing that can be described")


def _log_facts(log: ScanLog) -> dict[str, Any]:
    stamps = log.stamps_s
    return {
        "scans": len(log),
        "beams": len(log.scans.ranges_m),
        "lasers": _lasers(log.scans),
        "duration_s": float(stamps.max() - stamps.min()) if log.has_stamps and len(log) else None,
        "odometry_path_m": path_length_m(log.odometry),
        "has_odometry": log.has_odometry,
        "odometry_moves": log.odometry_moves,
        **_range_facts(log.scans),
        "has_stamps": log.has_stamps,
    }


def _log_notes(log: ScanLog) -> tuple[str, ...]:
    return () if log.odometry_moves or not log.has_odometry else ("the odometry never moves",)


def _graph_facts(graph: PoseGraph) -> dict[str, Any]:
    loops = int(np.count_nonzero(graph.is_loop))
    facts: dict[str, Any] = {
        "nodes": len(graph),
        "edges": len(graph.edges),
        "odometry_edges": len(graph.edges) - loops,
        "loop_edges": loops,
        "components": components(graph),
        "fixed_nodes": [int(graph.ids[k]) for k in graph.fixed],
        "extent_m": np.ptp(graph.poses[:, :2], axis=0).tolist() if len(graph) else [0.0, 0.0],
        "nodes_with_scans": 0,
    }
    if graph.scans is not None:
        facts["nodes_with_scans"] = int(np.count_nonzero(np.diff(graph.scans.offsets)))
        facts["lasers"] = _lasers(graph.scans)
        facts |= _range_facts(graph.scans)
    facts["has_stamps"] = graph.stamps_s is not None
    return facts


def _graph_notes(graph: PoseGraph) -> tuple[str, ...]:
    notes = [str(note) for note in graph.notes]
    if components(graph) > 1:
        notes.append("the graph is not connected")
    pairs = np.unique(np.sort(graph.edges, axis=1), axis=0)
    if len(pairs) < len(graph.edges):
        notes.append(f"{len(graph.edges) - len(pairs)} edges join nodes that another edge joins already")
    return tuple(notes)


def _trajectory_facts(trajectory: Trajectory) -> dict[str, Any]:
    stamps = trajectory.stamps_s
    return {
        "poses": len(trajectory),
        "duration_s": float(stamps.max() - stamps.min()),
        "path_m": path_length_m(trajectory.poses),
        "extent_m": np.ptp(trajectory.poses[:, :2], axis=0).tolist(),
        "stamps_rise": bool(np.all(np.diff(stamps) >= 0.0)),
    }


def _relations_facts(relations: Relations) -> dict[str, Any]:
    first, last = np.minimum(relations.t1_s, relations.t2_s).min(), np.maximum(relations.t1_s, relations.t2_s).max()
    distance = np.hypot(relations.relative_poses[:, 0], relations.relative_poses[:, 1])
    return {"relations": len(relations), "duration_s": float(last - first), "longest_m": float(distance.max())}


def _map_facts(grid: OccupancyMap) -> dict[str, Any]:
    rows, columns = grid.image.shape
    count = np.bincount(grid.image.ravel(), minlength=256)
    return {
        "rows": rows,
        "columns": columns,
        "resolution_m": grid.resolution_m,
        "origin": list(grid.origin),
        "free_cells": int(count[FREE]),
        "occupied_cells": int(count[OCCUPIED]),
        "unknown_cells": int(count[UNKNOWN]),
    }


def components(graph: PoseGraph) -> int:
    """The number of connected parts of the graph."""
    label = np.arange(len(graph))
    i, j = graph.edges.T
    while True:
        # Each node takes the least label of its neighbours, and then the label of that label.
        least = label.copy()
        np.minimum.at(least, i, label[j])
        np.minimum.at(least, j, label[i])
        least = np.minimum(least, least[least])
        if np.array_equal(least, label):
            return len(np.unique(label))
        label = least[least]


def _lasers(scans: Scans) -> list[dict[str, Any]]:
    used = np.bincount(scans.geometry_index[np.diff(scans.offsets) > 0], minlength=len(scans.geometries))
    return [_laser(geometry, int(count)) for geometry, count in zip(scans.geometries, used, strict=True)]


def _laser(geometry: LaserGeometry, scans: int) -> dict[str, Any]:
    return {
        "scans": scans,
        "beams": geometry.beam_count,
        "first_angle_rad": geometry.first_angle_rad,
        "angle_increment_rad": geometry.angle_increment_rad,
        "max_range_m": geometry.max_range_m,
        "T_robot_laser": list(geometry.T_robot_laser),
    }


def _range_facts(scans: Scans) -> dict[str, Any]:
    total, none, unusable, longest = max(len(scans.ranges_m), 1), 0, 0, 0.0
    for ranges in scans.blocks():
        none += int(np.count_nonzero(np.isinf(ranges)))
        unusable += int(np.count_nonzero(np.isnan(ranges)))
        longest = max(longest, float(ranges[np.isfinite(ranges)].max(initial=0.0)))
    return {
        "no_return_share": float(none / total),
        "unusable_share": float(unusable / total),
        "longest_reading_m": longest or None,
    }


def _laser_line(laser: dict[str, Any]) -> str:
    x, y, yaw = laser["T_robot_laser"]
    first, step = np.rad2deg(laser["first_angle_rad"]), np.rad2deg(laser["angle_increment_rad"])
    return (
        f"  laser: {laser['scans']} scans of {laser['beams']} beams from {first:g} deg in steps of {step:g} deg, "
        f"no return from {laser['max_range_m']:g} m on, mounted at x {x:g} m, y {y:g} m, {np.rad2deg(yaw):g} deg"
    )


_LISTS: dict[str, Callable[[dict[str, Any]], str]] = {
    "lasers": _laser_line,
    "topics": topic_line,
    "frames": frame_line,
}


def _label(key: str) -> str:
    return key.removesuffix("_m").removesuffix("_s").replace("_", " ")


def _shown(key: str, value: Any) -> str:
    if value is None:
        return "unknown"
    if isinstance(value, dict):
        return ", ".join(f"{_label(k)} {_shown(k, v)}" for k, v in value.items() if not isinstance(v, list | dict))
    if isinstance(value, bool):
        return "yes" if value else "no"
    if key.endswith("_share"):
        return f"{100.0 * value:.2f} %"
    unit = " m" if key.endswith("_m") else " s" if key.endswith("_s") else ""
    if isinstance(value, list):
        return " x ".join(f"{v:.2f}" for v in value) + unit if unit else " ".join(f"{v:g}" for v in value)
    return f"{value:.3f}{unit}" if isinstance(value, float) else f"{value}"
