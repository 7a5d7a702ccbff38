"""How accurate the maps of the two public recordings with true relations are, by each method, with defaults.

With --turns N, `igo` maps each log N times, each with another angle of the robot's first pose against the grid: the
grid's directions must not matter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from _measure import data_parser, log_path, markdown, relations_path, stop

from mapmend.compiling import watch_compiling
from mapmend.evaluation.relations import RelationErrors, relation_errors
from mapmend.geometry import se2
from mapmend.io.read_log import read_log
from mapmend.io.relations import Relations, read_relations
from mapmend.lab.altered_logs import turned
from mapmend.scan import ScanLog
from mapmend.slam import build_map

LOGS = ("intel", "fr079")
METHODS = ("igo", "go", "scanmatch", "odometry")
HEAD = ("log", "method", "translation [m]", "rotation [deg]", "relations", "loops", "seconds")


@dataclass(frozen=True)
class Measured:
    """One map's errors over the relations, its loop edges, and its seconds: no reading, writing or compiling."""

    errors: RelationErrors
    loops: int
    seconds: float

    def cells(self) -> tuple[str, ...]:
        e = self.errors
        return (
            f"{e.translation_mean_m:.4f} ± {e.translation_std_m:.4f}",
            f"{e.rotation_mean_deg:.3f}",
            f"{e.used} / {e.total}",
            str(self.loops),
            f"{self.seconds:.1f}",
        )


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--turns", type=int, default=0, metavar="N", help="map with N first headings instead")
    options = parser.parse_args()
    if options.turns < 0:
        stop("--turns must not be negative")
    rows: list[tuple[str, ...]] = []
    for name in LOGS:
        log = read_log(log_path(options.data, name))
        relations = read_relations(relations_path(options.data, name))
        rows += over_turns(name, log, relations, options.turns) if options.turns else by_method(name, log, relations)
    print(markdown(HEAD, rows))


def by_method(name: str, log: ScanLog, relations: Relations) -> list[tuple[str, ...]]:
    """A row a method."""
    return [(name, method, *measure(log, relations, method).cells()) for method in METHODS]


def over_turns(name: str, log: ScanLog, relations: Relations, turns: int) -> list[tuple[str, ...]]:
    """A row a heading, a quarter turn shared out: the grid's axes repeat there. Then the worst of them."""
    rows, worst_m, worst_deg = [], 0.0, 0.0
    for turn_rad in np.arange(turns) * (np.pi / 2.0 / turns):
        measured = measure(log, relations, "igo", float(turn_rad))
        rows.append((name, f"igo, turned {np.degrees(turn_rad):.1f}°", *measured.cells()))
        worst_m = max(worst_m, measured.errors.translation_mean_m)
        worst_deg = max(worst_deg, measured.errors.rotation_mean_deg)
    return [*rows, (name, f"worst of {turns}", f"{worst_m:.4f}", f"{worst_deg:.3f}", "", "", "")]


def measure(log: ScanLog, relations: Relations, method: str, turn_rad: float = 0.0) -> Measured:
    """Maps the log with the robot's first pose turned by ``turn_rad``; errors are those of the robot's own frame."""
    with watch_compiling(lambda: None) as compiling:
        result = build_map(turned(log, turn_rad), method)
    poses = se2.compose(result.trajectory.poses, np.array((0.0, 0.0, turn_rad)))
    errors = relation_errors(log.stamps_s, poses, relations.t1_s, relations.t2_s, relations.relative_poses)
    return Measured(errors, result.counts["loop_edges"], sum(result.seconds.values()) - compiling.seconds)


if __name__ == "__main__":
    main()
