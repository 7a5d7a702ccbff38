"""The figures of `slip.py`, after the IGO paper's 5 and 6: the seed at which go's error is the median.

Go's map of the log without slips is used as the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmend.evaluation.trajectory import align
from mapmend.geometry import se2
from mapmend.lab.method_figures import EdgePanel, TitledPath, draw_edges, draw_maps, draw_paths
from mapmend.scan import ScanLog
from mapmend.slam import METHODS, MapResult
from mapmend.view.figures import MapPanel

Float = NDArray[np.float64]

SHOWN = ("gmapping", "go", "igo")


@dataclass(frozen=True)
class Drawn:
    """What the figures show: the log with slips, ``mapped(log, method)``, the reference, an error by method."""

    name: str
    log: ScanLog
    mapped: Callable[[ScanLog, str], MapResult]
    reference: MapResult
    errors_m: dict[str, float]


def draw_all(drawn: Drawn, folder: Path) -> None:
    """slip-NAME-maps.png, slip-NAME-paths.png and slip-NAME-edges.png in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    truth = drawn.reference.trajectory.poses
    maps = [MapPanel("go, without slips", drawn.reference.occupancy, truth, np.zeros(3))]
    odometry = placed(drawn.log.odometry, truth)
    paths, edges = [TitledPath("odometry", odometry[1][:, :2])], []
    for name in SHOWN:
        if name not in METHODS:
            continue
        result = drawn.mapped(drawn.log, name)
        title = f"{name}: {drawn.errors_m[name]:.3f} m" if name in drawn.errors_m else name
        T_truth_map, poses = placed(result.trajectory.poses, truth)
        maps.append(MapPanel(title, result.occupancy, result.trajectory.poses, T_truth_map))
        paths.append(TitledPath(title, poses[:, :2]))
        nodes = se2.compose(T_truth_map, result.graph.poses)
        edges.append(EdgePanel(title, nodes[:, :2], too_long(result, drawn.log, truth)))
    draw_maps(maps, folder / f"slip-{drawn.name}-maps.png")
    draw_paths(TitledPath("go, without slips", truth[:, :2]), paths, folder / f"slip-{drawn.name}-paths.png")
    draw_edges(edges, folder / f"slip-{drawn.name}-edges.png")


def median_seed(rows: Sequence[Any]) -> int:
    """The seed of the median error among rows of one method and severity."""
    errors = sorted((one.error_m, one.seed) for one in rows)
    return int(errors[len(errors) // 2][1])


def placed(poses: Float, truth: Float) -> tuple[Float, Float]:
    """The alignment of poses (n, 3) with the truth, and the poses aligned."""
    T_truth_poses = align(poses[:, :2], truth[:, :2])
    return T_truth_poses, se2.compose(T_truth_poses, poses)


def too_long(result: MapResult, log: ScanLog, truth: Float) -> Float:
    """Of each odometry edge, what its measurement is longer than the truth, as a share of the truth."""
    assert result.graph.scans is not None
    rows = scan_rows(result, log)
    true_m = np.hypot(*np.diff(truth[rows, :2], axis=0).T)
    measured = result.graph.measurements[: len(rows) - 1]
    return np.asarray((np.hypot(measured[:, 0], measured[:, 1]) - true_m) / np.maximum(true_m, 0.05))


def scan_rows(result: MapResult, log: ScanLog) -> NDArray[np.int64]:
    """Which scan of the log each node carries: nodes keep the log's order, stamps repeat."""
    assert result.graph.stamps_s is not None
    rows, k = [], 0
    for stamp, pose in zip(result.graph.stamps_s, result.graph.poses, strict=True):
        while log.stamps_s[k] != stamp or not np.allclose(result.trajectory.poses[k], pose, atol=1e-9):
            k += 1
        rows.append(k)
        k += 1
    return np.array(rows)
