"""``mapmend demo``: a building, mapped by each method, beside the truth."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

from mapmend import __version__
from mapmend.commands.console import ProgressBar, print_json, table, thread_count, told_compiling
from mapmend.commands.simulate import write_simulation
from mapmend.config import Config
from mapmend.evaluation.trajectory import TrajectoryErrors, trajectory_errors
from mapmend.io.output import RUN_FILE, check_writable, whole_or_nothing, write_whole
from mapmend.run_folder import write_run
from mapmend.simulation import OdometryModel, Simulation, corridor_loop, simulate
from mapmend.slam import MapResult, build_map
from mapmend.view.figures import MapPanel, draw_comparison

METHODS = ("odometry", "scanmatch", "go", "igo")
PICTURE = "demo.png"

# Wheels as of a worn robot: they turn a little to the left and slip where the floor is waxed.
ODOMETRY = OdometryModel(rotation_bias_radpm=0.004, random_slip_count=4)


def run(options: Namespace) -> int:
    """Simulates, maps by each method, compares; leaves everything in one folder, whole or not at all."""
    check_writable(options.output)
    threads = thread_count(options.threads)
    simulation = simulate(corridor_loop(), odometry=ODOMETRY, seed=options.seed)
    rows: list[dict[str, Any]] = []
    panels: list[MapPanel] = []
    with whole_or_nothing(options.output) as place, told_compiling() as compiling:
        write_simulation(simulation, place)
        for method in METHODS:
            with ProgressBar() as progress:
                result = build_map(
                    simulation.log, method, replace(Config(), seed=options.seed), threads=threads, progress=progress
                )
            page = write_run(result, place / method, source="log.clf")
            errors = errors_of(result, simulation)
            rows.append(_row(method, errors, page))
            panels.append(_panel(method, errors, result))
        draw_comparison(simulation.world.walls, simulation.truth, panels, place / PICTURE)
        values = {"mapmend": __version__, "world": simulation.world.name, "seed": options.seed, "methods": rows}
        _write_page(values, place)
    if options.json:
        print_json({**values, "compile_seconds": round(compiling.seconds, 3), "output": options.output})
    else:
        print("\n".join(_lines(simulation, rows, options.output)))
    return 0


def errors_of(result: MapResult, simulation: Simulation) -> TrajectoryErrors:
    """The absolute trajectory error of a result: poses of the robot, aligned with the truth."""
    estimate = result.trajectory
    return trajectory_errors(estimate.stamps_s, estimate.poses, simulation.log.stamps_s, simulation.truth)


def _row(method: str, errors: TrajectoryErrors, page: dict[str, Any]) -> dict[str, Any]:
    return {
        "method": method,
        "absolute_rmse_m": errors.translation_rmse_m,
        "rotation_mean_deg": errors.rotation_mean_deg,
        "loop_edges": page["counts"]["loop_edges"],
        "seconds": round(sum(page["seconds"].values()), 3),
    }


def _panel(method: str, errors: TrajectoryErrors, result: MapResult) -> MapPanel:
    title = f"{method}: {errors.translation_rmse_m:.3f} m, {errors.rotation_mean_deg:.2f}°"
    return MapPanel(title, result.occupancy, result.trajectory.poses, errors.T_reference_estimate)


def _write_page(values: dict[str, Any], place: Path) -> None:
    """What tells the folder as ours, without the seconds, which no two runs share."""
    methods = [{name: value for name, value in row.items() if name != "seconds"} for row in values["methods"]]
    write_whole(place / RUN_FILE, json.dumps({**values, "methods": methods}, indent=2) + "\n")


def _lines(simulation: Simulation, rows: list[dict[str, Any]], folder: str) -> list[str]:
    cells = [
        (
            row["method"],
            f"{row['absolute_rmse_m']:.3f}",
            f"{row['rotation_mean_deg']:.2f}",
            str(row["loop_edges"]),
            f"{row['seconds']:.1f}",
        )
        for row in rows
    ]
    runs = ", ".join(f"{folder}/{row['method']}" for row in rows)
    return [
        f"{simulation.world.name}: {len(simulation.log)} scans, {simulation.path_m[-1]:.0f} m of path, "
        f"{len(simulation.slips)} slips of the wheels",
        "",
        table(("method", "error [m]", "rotation [deg]", "loops", "seconds"), cells),
        "",
        "error: RMSE of the absolute trajectory error after alignment; rotation: mean",
        f"picture: {folder}/{PICTURE}, runs: {runs}",
    ]
