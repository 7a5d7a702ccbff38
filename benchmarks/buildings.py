"""How accurate are maps of simulated buildings on which no setting was chosen, and how bad is the worst of them?

Each building is driven three times: with the wheels as they are, with wheels that turn 0.02 rad too far per metre and
count 3 % too much, and among people who are in three beams of ten, drawn again in every scan. Every run is appended to
--results as a line of JSON, and runs that are there are not repeated.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from _measure import markdown
from _seeds import Results, Spread

from mapmend.config import Config
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.lab.altered_logs import with_people
from mapmend.simulation import OdometryModel, random_building, simulate
from mapmend.slam import METHODS, build_map

BENT = OdometryModel(rotation_bias_radpm=0.02, translation_scale=1.03)
DRIVES = {"as they are": (None, 0.0), "bent odometry": (BENT, 0.0), "people": (None, 0.3)}
HEAD = ("drive", "method", "most above go [mm]", "buildings", "median error [m]", "quartiles", "worst", "in building")


@dataclass(frozen=True)
class Measured:
    """One method on one drive: the absolute trajectory error, that of the worst scan, and how many loops closed."""

    drive: str
    method: str
    seed: int
    error_m: float
    error_max_m: float
    loops: int


def key_of(one: Measured) -> tuple[Any, ...]:
    return one.drive, one.method, one.seed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24, metavar="N", help="buildings (default: 24)")
    parser.add_argument("--first", type=int, default=100, metavar="SEED", help="of the first (default: 100)")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=["go", "igo"], metavar="M")
    parser.add_argument("--drives", nargs="+", choices=list(DRIVES), default=list(DRIVES), metavar="D")
    parser.add_argument("--results", type=Path, default=Path("buildings.jsonl"), help="default: %(default)s")
    parser.add_argument("--only-print", action="store_true", help="the table of what was measured before")
    options = parser.parse_args()
    results = Results(options.results, Measured, key_of)
    seeds = range(options.first, options.first + options.seeds)
    if not options.only_print:
        results.measure(((d, m, s) for s in seeds for d in options.drives for m in options.methods), measure)
    print(table([one for one in results.rows if one.drive in options.drives and one.method in options.methods]))


def measure(drive: str, method: str, seed: int) -> Measured:
    """Drives through the building, maps it with defaults, compares with the truth."""
    odometry, share = DRIVES[drive]
    simulation = simulate(random_building(seed), None, odometry, seed)
    log = with_people(simulation.log, share, seed)
    result = build_map(log, method, Config())
    found = trajectory_errors(log.stamps_s, result.trajectory.poses, log.stamps_s, simulation.truth)
    loops = int(result.counts.get("loop_edges", 0))
    return Measured(drive, method, seed, found.translation_rmse_m, found.translation_max_m, loops)


def table(rows: Sequence[Measured]) -> str:
    """A row a drive and method; beside it in which building it is farthest above go, and by how much."""
    errors: dict[tuple[str, str], dict[int, float]] = {}
    for one in rows:
        errors.setdefault((one.drive, one.method), {})[one.seed] = one.error_m
    lines = []
    for (drive, method), mine in errors.items():
        go = errors.get((drive, "go"), {})
        above = {seed: 1e3 * (mine[seed] - go[seed]) for seed in mine.keys() & go.keys()}
        most = max(above, key=lambda seed: above[seed], default=0)
        shown = f"{above[most]:+.1f} ({most})" if above and method != "go" else ""
        lines.append((drive, method, shown, *Spread.of(mine).cells(4)))
    return markdown(HEAD, lines)


if __name__ == "__main__":
    main()
