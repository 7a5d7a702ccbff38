"""What the report shows of a RUN: its graph, its map, and the result of the check."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config, to_dict
from mapmend.consistency.check import CheckResult, check
from mapmend.errors import InputError, MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.nav2 import read_map
from mapmend.io.own_files import RUN_FILE, is_older_file
from mapmend.io.reader import read_run
from mapmend.maps import OCCUPIED, OccupancyMap
from mapmend.parallel import Progress, no_progress
from mapmend.report.embedding import packed, packed_map
from mapmend.scan import Scans
from mapmend.trajectory import Trajectory

Float = NDArray[np.float64]

TUNE_FILE = "tune.json"
MOST_READINGS = 1_500_000
"""If there are more laser readings, only every few beams are kept: 3 MB in the page."""

READINGS_PER_M = 500.0
"""Readings are kept in steps of 2 mm, up to 131 m, in two bytes."""

MOST_POINTS = 100_000
STEP_M = 0.01
"""A scan is left out of the trajectory's line if the robot moved less than this since the last one drawn."""

FEW_WALLS, MARGIN_M = 0.003, 1.0
"""The first view leaves out this share of the walls on each side, and shows this margin around the rest."""

ODOMETRY, STRETCH, LOOP = 0, 1, 2


@dataclass(frozen=True)
class Run:
    """A RUN folder, read; ``run_json`` is its run.json. If ``result`` is None, ``unchecked`` says why.

    ``tune``: the output of ``mapmend tune RUN --json``, if it is in the RUN as tune.json. None and
    ``has_older_tuning`` if that file is older than the map: it describes another graph.
    """

    name: str
    run_json: dict[str, Any]
    trajectory: Trajectory
    graph: PoseGraph
    grid: OccupancyMap
    result: CheckResult | None
    unchecked: str = ""
    tune: dict[str, Any] | None = None
    has_older_tuning: bool = False


def read_checked(folder: str | Path, config: Config, *, threads: int = 1, progress: Progress = no_progress) -> Run:
    """A RUN folder with the check of its graph; raises InputError if it is not a RUN, or a damaged one."""
    trajectory, graph = read_run(folder)
    if graph is None:
        raise InputError(folder, "the RUN holds no graph.g2o", "map the log again")
    run_json = read_run_json(folder)
    grid = read_map(Path(folder) / "map.yaml")
    name = Path(folder).resolve().name
    tune = _read_object(Path(folder) / TUNE_FILE) if (Path(folder) / TUNE_FILE).is_file() else None
    is_older = tune is not None and is_older_file(run_json, Path(folder) / TUNE_FILE)
    run = Run(name, run_json, trajectory, graph, grid, None, "", None if is_older else tune, is_older)
    try:
        return replace(run, result=check(graph, config, threads=threads, progress=progress))
    except MapmendError as error:
        return replace(run, unchecked=str(error))


def read_run_json(folder: str | Path) -> dict[str, Any]:
    """A RUN's run.json; raises InputError."""
    path = Path(folder) / RUN_FILE
    if not path.is_file():
        raise InputError(folder, f"is no RUN folder: it holds no {RUN_FILE}", "name what `mapmend map` wrote")
    return _read_object(path)


def _read_object(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_bytes())
    except (ValueError, OSError) as error:
        raise InputError(path, f"can't be read ({error})", "write it again") from None
    if not isinstance(values, dict):
        raise InputError(path, "holds no JSON object", "write it again")
    return values


def run_values(run: Run) -> dict[str, Any]:
    """All data of a RUN that the page needs, ready for JSON."""
    graph = run.graph
    first_s = float(run.trajectory.stamps_s[0]) if len(run.trajectory) else 0.0
    facts = ("mapmend", "method", "seed", "log", "chi2_initial", "chi2_final")
    return {
        "name": run.name,
        "page": {key: run.run_json.get(key) for key in facts},
        "counts": run.run_json.get("counts", {}),
        "seconds": run.run_json.get("seconds", {}),
        "path_m": run.run_json.get("path_m"),
        "turned_rad": _turned_rad(run.run_json),
        "mended": run.run_json.get("mended"),
        "tune": run.tune,
        "first_stamp_s": first_s,
        "last_s": float(np.max(run.trajectory.stamps_s, initial=first_s)) - first_s,
        "settings": _settings(run.run_json.get("configuration")),
        "map": packed_map(run.grid),
        "bounds_m": _bounds(run),
        "verdict": _verdict(run),
        "trajectory": _trajectory(run.trajectory, first_s),
        "nodes": _nodes(run, first_s),
        "edges": _edges(graph),
        "suspects": _suspects(run.result),
        "points": packed(_points(run.result), "float32"),
        "regions": _regions(run.result),
        "scans": None if graph.scans is None else _scans(graph.scans),
    }


def _turned_rad(run_json: dict[str, Any]) -> float:
    """The turn of the map by ``--align``."""
    alignment = run_json.get("alignment")
    return float(alignment["T_map_start"][2]) if isinstance(alignment, dict) else 0.0


def _settings(used: Any) -> list[list[Any]]:
    """Every setting of the RUN with its default, ``[name, value, default]``, where this version has the setting."""
    tables = used if isinstance(used, dict) else {}
    known = to_dict(Config())
    rows = []
    for block, values in tables.items():
        if isinstance(values, dict):
            defaults = known.get(block, {})
            rows += [[f"{block}.{key}", value, defaults.get(key)] for key, value in values.items()]
        else:
            rows.append([block, values, known.get(block)])
    return rows


def _bounds(run: Run) -> list[float]:
    """Low x, low y, high x, high y of the interesting part: single beams leave most buildings through glass."""
    rows, columns = np.nonzero(run.grid.image == OCCUPIED)
    walls = np.array(run.grid.origin[:2]) + (np.stack((columns, rows), axis=1) + 0.5) * run.grid.resolution_m
    places = run.trajectory.poses[:, :2]
    if len(walls):
        places = np.concatenate((places, np.quantile(walls, (FEW_WALLS, 1.0 - FEW_WALLS), axis=0)))
    low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    return [*low.tolist(), *high.tolist()]


def _verdict(run: Run) -> dict[str, Any]:
    result = run.result
    if result is None:
        return {"checked": False, "why": run.unchecked}
    return {
        "checked": True,
        "consistent": result.consistent,
        "p_value": result.p_value,
        "scans_tested": result.scans.count,
        "scans_failed": int(np.count_nonzero(result.scans.failed)),
        "pairs": len(result.pairs.pairs),
        "pairs_failed": int(np.count_nonzero(result.pairs.failed)),
        "notes": list(result.notes),
    }


def _trajectory(trajectory: Trajectory, first_s: float) -> dict[str, Any]:
    """The line to draw: seconds since the first scan, and positions."""
    places = trajectory.poses[:, :2]
    kept = [0] if len(places) else []
    last = places[0] if len(places) else None
    for k in range(1, len(places)):
        if np.abs(places[k] - last).max() >= STEP_M or k == len(places) - 1:
            kept.append(k)
            last = places[k]
    return {
        "scans": len(places),
        "t_s": packed(trajectory.stamps_s[kept] - first_s, "float32"),
        "xy_m": packed(places[kept], "float32"),
    }


def _nodes(run: Run, first_s: float) -> dict[str, Any]:
    graph, n = run.graph, len(run.graph)
    stamps = np.full(n, np.nan) if graph.stamps_s is None else graph.stamps_s
    key_nodes = run.run_json.get("key_nodes")
    std_m, std_rad = _stds(graph)
    values = {
        "count": n,
        "id": packed(graph.ids, "float64"),
        "pose": packed(graph.poses, "float32"),
        "t_s": packed(stamps - first_s, "float32"),
        "std_m": packed(std_m, "float32"),
        "std_deg": packed(np.degrees(std_rad), "float32"),
        "knows_key_nodes": key_nodes is not None,
        "is_key": packed(np.isin(graph.ids, np.array(key_nodes or [], dtype=np.int64)), "uint8"),
    }
    if run.result is not None:
        tests = run.result.scans
        values |= {
            "tested": packed(tests.tested, "int32"),
            "failures": packed(tests.failures, "int32"),
            "p_value": packed(tests.p_values, "float32"),
            "failed": packed(tests.failed, "uint8"),
        }
    return values


def _stds(graph: PoseGraph) -> tuple[Float, Float]:
    """Standard deviations of each node relative to the fixed one: along the longer axis, metres, and heading,
    radians."""
    from mapmend.graph.marginals import marginals
    from mapmend.graph.optimizer import optimize

    try:
        covariances = marginals(optimize(graph).factorization)
    except MapmendError:
        return np.full(len(graph), np.nan), np.full(len(graph), np.nan)
    longest = np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]
    return np.sqrt(np.maximum(longest, 0.0)), np.sqrt(np.maximum(covariances[:, 2, 2], 0.0))


def _edges(graph: PoseGraph) -> dict[str, Any]:
    from mapmend.graph.optimizer import edge_chi2, edge_errors

    kind = np.where(graph.is_loop, LOOP, ODOMETRY)
    # A stretch edge is odometry over several nodes; if the nodes have no order in time, no edge is a stretch edge.
    is_long = np.abs(graph.edges[:, 1] - graph.edges[:, 0]) > 1
    kind[~graph.is_loop & is_long] = STRETCH
    errors = edge_errors(graph)
    return {
        "i": packed(graph.edges[:, 0], "int32"),
        "j": packed(graph.edges[:, 1], "int32"),
        "kind": packed(kind, "uint8"),
        "chi2": packed(edge_chi2(graph), "float32"),
        "off_m": packed(np.hypot(errors[:, 0], errors[:, 1]), "float32"),
        "off_deg": packed(np.degrees(errors[:, 2]), "float32"),
    }


def _suspects(result: CheckResult | None) -> dict[str, Any]:
    """Rows of edges with the evidence against each, the most suspect first; edges without evidence are left out."""
    if result is None:
        return {"edge": packed([], "int32"), "against": packed([], "float32")}
    some = result.against > 0.0
    return {"edge": packed(result.suspects[some], "int32"), "against": packed(result.against[some], "float32")}


def _points(result: CheckResult | None) -> Float:
    """The contradicting end points in the map, (k, 2)."""
    if result is None:
        return np.zeros((0, 2))
    points = result.views.points_in_map()[result.points]
    return points[:: max(1, -(-len(points) // MOST_POINTS))]


def _regions(result: CheckResult | None) -> list[dict[str, Any]]:
    return [
        {
            "x_m": region.place_m[0],
            "y_m": region.place_m[1],
            "size_m": region.size_m,
            "pairs_failed": region.failures,
            "nodes": region.scans.tolist(),
            "loops": region.loops.tolist(),
        }
        for region in ([] if result is None else result.regions)
    ]


def _scans(scans: Scans) -> dict[str, Any]:
    """The nodes' readings, only every few beams if there are too many."""
    stride = max(1, -(-len(scans.ranges_m) // MOST_READINGS))
    parts, counts = [], []
    for k in range(len(scans)):
        part = scans.ranges_of(k)[::stride]
        parts.append(part)
        counts.append(len(part))
    ranges = np.concatenate(parts) if parts else np.zeros(0, np.float32)
    most = np.array([g.max_range_m for g in scans.geometries] or [0.0])[np.repeat(scans.geometry_index, counts)]
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(ranges) & (ranges < most) & (ranges < 65535 / READINGS_PER_M)
    return {
        "per_m": READINGS_PER_M,
        "readings": packed(np.where(seen, np.rint(np.where(seen, ranges, 0.0) * READINGS_PER_M), 0), "uint16"),
        "offsets": packed(np.concatenate(([0], np.cumsum(counts))), "int32"),
        "laser": packed(scans.geometry_index, "int32"),
        "lasers": [[g.first_angle_rad, g.angle_increment_rad * stride, *g.T_robot_laser] for g in scans.geometries],
    }
