"""The figures of `corridor.py`, after the IGO paper's 6 and 7: the seed at which go's error is the median."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.geometry import se2
from mapmend.lab.method_figures import EdgePanel, TitledPath, draw_edges, draw_paths
from mapmend.simulation import Simulation
from mapmend.slam import METHODS, MapResult, build_map
from mapmend.view.figures import MapPanel, draw_comparison

Float = NDArray[np.float64]

DRIVE = "laser alone"
SHOWN = ("gmapping", "go", "igo")


def draw_all(rows: Sequence[Any], drives: Mapping[str, Any], folder: Path) -> None:
    """corridor-maps.png, corridor-paths.png and corridor-edges.png in ``folder``."""
    errors = sorted((one.error_m, one.seed) for one in rows if (one.drive, one.method) == (DRIVE, "go"))
    seed = errors[len(errors) // 2][1]
    drive = drives[DRIVE]
    simulation = drive.simulation(seed)
    results = {name: build_map(simulation.log, name, drive.config(seed)) for name in SHOWN if name in METHODS}
    folder.mkdir(parents=True, exist_ok=True)
    maps, paths, edges = [], [], []
    for name, result in results.items():
        found = errors_of(result, simulation)
        title = f"{name}: {found.translation_rmse_m:.2f} m"
        T_world_map = found.T_reference_estimate
        maps.append(MapPanel(title, result.occupancy, result.trajectory.poses, T_world_map))
        paths.append(TitledPath(title, se2.compose(T_world_map, result.trajectory.poses)[:, :2]))
        if name != "scanmatch":
            nodes = se2.compose(T_world_map, result.graph.poses)
            edges.append(EdgePanel(title, nodes[:, :2], too_long(result, simulation)))
    draw_comparison(simulation.world.walls, simulation.truth, maps, folder / "corridor-maps.png")
    draw_paths(TitledPath("truth", simulation.truth[:, :2]), paths, folder / "corridor-paths.png")
    draw_edges(edges, folder / "corridor-edges.png")


def errors_of(result: MapResult, simulation: Simulation) -> Any:
    stamps = simulation.log.stamps_s
    return trajectory_errors(stamps, result.trajectory.poses, stamps, simulation.truth)


def too_long(result: MapResult, simulation: Simulation) -> Float:
    """Of each odometry edge, what its measurement is longer than the truth, as a share of the truth."""
    assert result.graph.stamps_s is not None
    truth = simulation.truth[np.searchsorted(simulation.log.stamps_s, result.graph.stamps_s)]
    true_m = np.hypot(*np.diff(truth[:, :2], axis=0).T)
    measured = result.graph.measurements[: len(truth) - 1]
    return np.asarray((np.hypot(measured[:, 0], measured[:, 1]) - true_m) / np.maximum(true_m, 0.05))
