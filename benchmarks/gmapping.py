"""How right the particle filter's maps of intel and fr079 are, over seeds, with and without jumps in the odometry.

Jumps are seeded and lie between two scans at random places (``lab/odometry_jumps.py``): the odometry reports a step of
--length in a random direction with a turn of --turn to a random side that did not happen. Errors are those over all
true relations; a run is lost above 0.1 m. Every run is appended to --results as a line of JSON, and what is there is
not run again.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from _measure import log_path, markdown, relations_path
from _seeds import HEAD, Results, Spread

from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.io.read_log import read_log
from mapmend.io.relations import read_relations
from mapmend.lab.odometry_jumps import PLACES, JumpModel, with_jumps
from mapmend.slam import build_map

LOGS = ("intel", "fr079")
LOST_M = 0.1
NO_JUMPS = JumpModel(0, 0.0, 0.0)
TURN_RAD = 1.0


@dataclass(frozen=True)
class Measured:
    """One map: its errors over the relations and the seconds of processor time."""

    log: str
    count: int
    length_m: float
    turn_rad: float
    place: str
    seed: int
    error_m: float
    error_max_m: float
    rotation_deg: float
    cpu_s: float

    @property
    def jumps(self) -> JumpModel:
        return JumpModel(self.count, self.length_m, self.turn_rad, self.place)


def key_of(one: Measured) -> tuple[Any, ...]:
    return one.log, one.jumps, one.seed


def main() -> None:
    options = parsed()
    results = Results(options.results, Measured, key_of)
    jumps = JumpModel(options.count, options.length, options.turn, options.place)
    seeds = range(options.first, options.first + options.seeds)
    cases = [(name, model, seed) for seed in seeds for name in options.logs for model in (NO_JUMPS, jumps)]

    def measure(name: str, model: JumpModel, seed: int) -> Measured:
        log = read_log(log_path(os.environ.get("MAPMEND_DATA"), name))
        relations = read_relations(relations_path(os.environ.get("MAPMEND_DATA"), name))
        log, _ = with_jumps(log, model, seed)
        began = time.process_time()
        result = build_map(log, "gmapping", replace(Config(), seed=seed), threads=options.threads)
        cpu_s = time.process_time() - began
        found = relation_errors(
            log.stamps_s, result.trajectory.poses, relations.t1_s, relations.t2_s, relations.relative_poses
        )
        errors = found.translation_mean_m, found.translation_max_m, found.rotation_mean_deg
        return Measured(name, model.count, model.length_m, model.turn_rad, model.place, seed, *errors, cpu_s)

    if not options.only_print:
        results.measure(cases, measure)
    wanted = set(cases)
    print(table([one for one in results.rows if (one.log, one.jumps, one.seed) in wanted]))


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="+", choices=LOGS, default=list(LOGS), metavar="LOG", help="below MAPMEND_DATA")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="default: %(default)s")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="of the first (default: %(default)s)")
    parser.add_argument("--count", type=int, default=3, metavar="N", help="jumps in a log (default: %(default)s)")
    parser.add_argument("--length", type=float, default=2.0, metavar="M", help="of a jump (default: %(default)s)")
    parser.add_argument("--turn", type=float, default=TURN_RAD, metavar="RAD", help="of a jump (default: %(default)s)")
    parser.add_argument("--place", choices=PLACES, default="any", help="what the robot does there (default: any)")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="default: %(default)s")
    parser.add_argument("--results", type=Path, default=Path("gmapping.jsonl"), help="default: %(default)s")
    parser.add_argument("--only-print", action="store_true", help="the table of what was measured before")
    return parser.parse_args()


def table(rows: Sequence[Measured]) -> str:
    """A row a log and kind of jumps."""
    runs: dict[tuple[str, JumpModel], dict[int, Measured]] = {}
    for one in rows:
        runs.setdefault((one.log, one.jumps), {})[one.seed] = one
    lines = []
    for (name, jumps), mine in runs.items():
        errors = {seed: one.error_m for seed, one in mine.items()}
        lost = sum(error > LOST_M for error in errors.values())
        each = " ".join(f"{errors[seed]:.4f}" for seed in sorted(errors))
        words = f"{jumps.count} of {jumps.length_m:g} m and {jumps.turn_rad:g} rad" if jumps.count else "none"
        lines.append((name, words, *Spread.of(errors).cells(4), f"{lost}", each))
    return markdown(("log", "jumps", *HEAD, "lost", "by seed [m]"), lines)


if __name__ == "__main__":
    main()
