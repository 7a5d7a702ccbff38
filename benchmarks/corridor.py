"""Experiment II of the IGO paper: a loop of featureless corridors, 17 m x 22 m, mapped from the laser alone.

The absolute trajectory error of each method over seeds of the simulation, aligned as ``mapmend eval --reference`` does.
``known ends`` is not a method but shows what can still be gained: the truth wherever a scan observes the motion along
the corridor, and elsewhere the speed that laser odometry measured just before and a little after, changing evenly.

Four drives: from the laser alone at an even speed; the same at a speed that wanders by a twentieth; with wheels; with
wheels that slip four times. Every run is appended to --results as a line of JSON, and runs that are there are not
repeated.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from _open_stretches import known_ends
from _seeds import Results, paired, spread_table
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.simulation import OdometryModel, Simulation, corridor_loop, simulate
from mapmend.slam import METHODS, build_map

Float = NDArray[np.float64]

KNOWN_ENDS = "known ends"
SLIPPING = OdometryModel(random_slip_count=4)


@dataclass(frozen=True)
class Drive:
    """How the corridor is driven, and whether the odometry is used."""

    odometry: OdometryModel
    speed_std_share: float
    use_odometry: bool

    def simulation(self, seed: int) -> Simulation:
        return simulate(corridor_loop(), None, self.odometry, seed, speed_std_share=self.speed_std_share)

    def config(self, seed: int) -> Config:
        config = Config(seed=seed)
        return replace(config, motion=replace(config.motion, use_odometry=self.use_odometry))


DRIVES = {
    "laser alone": Drive(OdometryModel(), 0.0, use_odometry=False),
    "laser alone, speed wanders": Drive(OdometryModel(), 0.05, use_odometry=False),
    "wheels": Drive(OdometryModel(), 0.0, use_odometry=True),
    "wheels that slip": Drive(SLIPPING, 0.0, use_odometry=True),
}

LEG_ENDS_M = (0.0, 15.5, 36.0, 51.5, 72.5)
"""Where the four legs between the corners begin and end, along the way."""


@dataclass(frozen=True)
class Measured:
    """One method on one drive. ``legs_m``: by how much it makes each of the four legs too long."""

    drive: str
    method: str
    seed: int
    error_m: float
    rotation_deg: float
    legs_m: tuple[float, ...]
    loops: int
    seconds: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="default: %(default)s")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of the first (default: %(default)s)")
    parser.add_argument("--drives", nargs="+", choices=list(DRIVES), default=list(DRIVES), metavar="D")
    methods, default = [*METHODS, KNOWN_ENDS], ["scanmatch", "go", "igo", KNOWN_ENDS]
    parser.add_argument("--methods", nargs="+", choices=methods, default=default, metavar="M")
    parser.add_argument("--results", type=Path, default=Path("corridor.jsonl"), help="default: %(default)s")
    parser.add_argument("--only-print", action="store_true", help="the tables of what was measured before")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw the seed of go's median error into DIR")
    options = parser.parse_args()
    results = Results(options.results, Measured, lambda one: (one.drive, one.method, one.seed))
    if not options.only_print:
        seeds = range(options.first, options.first + options.seeds)
        results.measure(
            ((d, m, seed) for seed in seeds for d in options.drives for m in options.methods if is_possible(d, m)),
            measure,
        )
    print(tables(results.rows))
    if options.pictures:
        from _corridor_pictures import draw_all

        draw_all(results.rows, DRIVES, options.pictures)


def is_possible(drive: str, method: str) -> bool:
    """Raw odometry needs wheels; known ends are for driving without them."""
    return (
        DRIVES[drive].use_odometry if method == "odometry" else method != KNOWN_ENDS or not DRIVES[drive].use_odometry
    )


def measure(drive: str, method: str, seed: int) -> Measured:
    """Simulates, maps, compares."""
    simulation, config = DRIVES[drive].simulation(seed), DRIVES[drive].config(seed)
    result = build_map(simulation.log, "scanmatch" if method == KNOWN_ENDS else method, config)
    poses = result.trajectory.poses
    if method == KNOWN_ENDS:
        poses = known_ends(simulation, poses)
    stamps = simulation.log.stamps_s
    errors = trajectory_errors(stamps, poses, stamps, simulation.truth)
    return Measured(
        drive,
        method,
        seed,
        errors.translation_rmse_m,
        errors.rotation_mean_deg,
        legs_too_long_m(simulation, poses),
        result.counts["loop_edges"],
        sum(result.seconds.values()),
    )


def legs_too_long_m(simulation: Simulation, poses: Float) -> tuple[float, ...]:
    """By how much the poses make each leg longer than it is."""
    rows = np.searchsorted(simulation.path_m, LEG_ENDS_M)
    estimate, truth = (np.hypot(*np.diff(p[rows, :2], axis=0).T) for p in (poses, simulation.truth))
    return tuple(np.round(estimate - truth, 4).tolist())


def tables(rows: Sequence[Measured]) -> str:
    """The spread of each method on each drive, and the errors of its worst seed."""
    parts, notes = [], []
    for drive in DRIVES:
        for method in (*METHODS, KNOWN_ENDS):
            mine = [one for one in rows if (one.drive, one.method) == (drive, method)]
            if not mine:
                continue
            errors = {one.seed: one.error_m for one in mine}
            go = {one.seed: one.error_m for one in rows if (one.drive, one.method) == (drive, "go")}
            parts.append(((drive, method, "" if method in ("go", KNOWN_ENDS) else paired(errors, go)), errors))
            worst = max(mine, key=lambda one: one.error_m)
            legs = ", ".join(f"{leg:+.2f}" for leg in worst.legs_m)
            what = f"legs {legs} m too long, heading {worst.rotation_deg:.2f}° off, {worst.loops} loop edges"
            notes.append(f"- {drive}, {method}, seed {worst.seed}: {what}")
    table = spread_table(("drive", "method", "worse than go"), parts)
    return f"Absolute trajectory error [m]\n\n{table}\n\nThe worst seeds:\n\n" + "\n".join(notes)


if __name__ == "__main__":
    main()
