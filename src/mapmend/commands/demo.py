"""``mapmend demo``: a building, mapped by each method, beside the truth."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, Any

from mapmend.commands.common.console import ProgressBar, print_json, say_older, table, told_compiling
from mapmend.commands.common.options import add_threads, thread_count, whole_number
from mapmend.commands.common.simulated import write_simulation
from mapmend.io.output import check_writable, whole_or_nothing
from mapmend.io.own_files import DEMO_PICTURE, RUN_FILES, SIMULATION_FILES
from mapmend.version import VERSION

if TYPE_CHECKING:
    from mapmend.evaluation.trajectory import TrajectoryErrors
    from mapmend.simulation import Simulation
    from mapmend.slam import MapResult
    from mapmend.view.figures import MapPanel

METHODS = ("odometry", "scanmatch", "go", "igo")
FILES = (DEMO_PICTURE, *SIMULATION_FILES, *(f"{method}/{name}" for method in METHODS for name in RUN_FILES))

# The wheels of a worn robot: they turn a little to the left and slip where the floor is waxed.
ROTATION_BIAS_RADPM, SLIPS = 0.004, 4


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = (
        "Writes the log, the truth, a RUN folder for each method, and demo.png. Replaces the files of an earlier demo."
    )
    parser.add_argument("-o", "--output", metavar="DIR", default="demo", help="folder to write (default: demo)")
    parser.add_argument(
        "--seed", type=whole_number, default=1, metavar="N", help="seed of noise and slips (default: 1)"
    )
    add_threads(parser)


def run(args: Namespace) -> int:
    """Simulates, maps by each method, compares; leaves everything in one folder, whole or not at all."""
    from mapmend.config import Config
    from mapmend.run_folder import write_run
    from mapmend.slam import build_map
    from mapmend.view.figures import draw_comparison

    check_writable(args.output, FILES)
    threads = thread_count(args.threads)
    simulation = demo_drive(args.seed)
    rows: list[dict[str, Any]] = []
    panels: list[MapPanel] = []
    with whole_or_nothing(args.output, FILES) as output, told_compiling() as compiling:
        write_simulation(simulation, output.path)
        for method in METHODS:
            with ProgressBar() as progress:
                result = build_map(simulation.log, method, Config(seed=args.seed), threads=threads, progress=progress)
            run_json = write_run(result, output.path / method, source="log.clf")
            errors = errors_of(result, simulation)
            rows.append(_row(method, errors, run_json))
            panels.append(_panel(method, errors, result))
        draw_comparison(simulation.world.walls, simulation.truth, panels, output.path / DEMO_PICTURE)
        values = {"mapmend": VERSION, "world": simulation.world.name, "seed": args.seed, "methods": rows}
        run_json = output.write_run_json(_without_seconds(values))
    say_older(run_json)
    if args.json:
        print_json({**values, "compile_seconds": round(compiling.seconds, 3), "output": args.output})
    else:
        print("\n".join(_lines(simulation, rows, args.output)))
    return 0


def demo_drive(seed: int) -> Simulation:
    """The drive that the demo maps."""
    from mapmend.simulation import OdometryModel, corridor_loop, simulate

    odometry = OdometryModel(rotation_bias_radpm=ROTATION_BIAS_RADPM, random_slip_count=SLIPS)
    return simulate(corridor_loop(), odometry=odometry, seed=seed)


def errors_of(result: MapResult, simulation: Simulation) -> TrajectoryErrors:
    """The absolute trajectory error of a result: poses of the robot, aligned with the truth."""
    from mapmend.evaluation.trajectory import trajectory_errors

    estimate = result.trajectory
    return trajectory_errors(estimate.stamps_s, estimate.poses, simulation.log.stamps_s, simulation.truth)


def _row(method: str, errors: TrajectoryErrors, run_json: dict[str, Any]) -> dict[str, Any]:
    return {
        "method": method,
        "absolute_rmse_m": errors.translation_rmse_m,
        "rotation_mean_deg": errors.rotation_mean_deg,
        "loop_edges": run_json["counts"]["loop_edges"],
        "seconds": round(sum(run_json["seconds"].values()), 3),
    }


def _panel(method: str, errors: TrajectoryErrors, result: MapResult) -> MapPanel:
    from mapmend.view.figures import MapPanel

    title = f"{method}: {errors.translation_rmse_m:.3f} m, {errors.rotation_mean_deg:.2f}°"
    return MapPanel(title, result.occupancy, result.trajectory.poses, errors.T_reference_estimate)


def _without_seconds(values: dict[str, Any]) -> dict[str, Any]:
    """What run.json holds: all but the seconds, which no two runs share."""
    methods = [{name: value for name, value in row.items() if name != "seconds"} for row in values["methods"]]
    return {**values, "methods": methods}


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
        f"picture: {folder}/{DEMO_PICTURE}, runs: {runs}",
    ]
