"""Where `optimize` ends from each start: chi2 from the given poses, the odometry, the chordal start, and by `auto`.

Public graphs; M3500 and intel with noise added to their measured angles, of each a number of seeds, with their
information as it is and a hundredth of it (covariances stated too wide, the case that may hide a poor end from `auto`);
and graphs with 100 false loops, optimized with the kernel dcs, where costs stand instead of chi2. A row of several
seeds holds medians. "missed" counts the seeds at which `auto` ended more than a thousandth above the best of the given
and the chordal start. "time" is that of `auto` over that from the given poses, each the least of --repeats calls made
in turns.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from _measure import data_parser, markdown, stop

from mapmend.graph.best_start import optimize_from
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import kernel_of
from mapmend.io.g2o import read_g2o
from mapmend.lab.false_loops import add_false_loops
from mapmend.lab.graph_noise import with_angle_noise

PUBLIC = (
    "posegraphs/intel", "posegraphs/M3500", "posegraphs/M3500a", "posegraphs/ringCity", "posegraphs/bicocca25b_0.000",
    "posegraphs/bicocca25b_0.200", "posegraphs/bicocca25b_0.500", "scangraphs/killian",
)  # fmt: skip
NOISY = (("posegraphs/M3500", (0.05, 0.1, 0.2)), ("posegraphs/intel", (0.02, 0.05, 0.1)))
WITH_FALSE_LOOPS = ("posegraphs/intel", "posegraphs/M3500", "posegraphs/ringCity")
STARTS = ("given", "odometry", "chordal", "auto")
WIDE = 0.01
FALSE_LOOPS = 100


@dataclass(frozen=True)
class Case:
    """One row: graphs that differ in their seeds."""

    name: str
    graphs: tuple[PoseGraph, ...]
    kernel: str = "none"


@dataclass(frozen=True)
class Measured:
    """Of one graph: the cost at the end from each of ``STARTS``, what auto took, and its time over given's."""

    costs: dict[str, float]
    taken: str
    tried: int
    ratio: float

    @property
    def missed(self) -> bool:
        return self.costs["auto"] > 1.001 * min(self.costs["given"], self.costs["chordal"])


def main() -> None:
    parser = data_parser(__doc__)
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="of each graph with noise (default: 5)")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="calls that are timed (default: 5)")
    options = parser.parse_args()
    if not options.data or not (Path(options.data) / "posegraphs").is_dir():
        stop("name the folder with posegraphs/, or set MAPMEND_DATA")
    rows = [
        row(case, [measure(graph, case.kernel, options.repeats) for graph in case.graphs])
        for case in cases(Path(options.data), options.seeds)
    ]
    head = ("graph", *STARTS, "auto took chordal", "auto tried both", "missed", "time")
    print(markdown(head, rows))


def cases(data: Path, seeds: int) -> Iterator[Case]:
    for name in PUBLIC:
        yield Case(name, (read_g2o(data / f"{name}.g2o.gz"),))
    for name, sigmas in NOISY:
        graph = read_g2o(data / f"{name}.g2o.gz")
        for scale in (1.0, WIDE):
            for sigma in sigmas:
                noisy = [with_angle_noise(graph, sigma, seed) for seed in range(seeds)]
                scaled = tuple(replace(one, information=scale * one.information) for one in noisy)
                yield Case(f"{name}, {sigma:g} rad" + (f", information x {scale:g}" if scale != 1.0 else ""), scaled)
    for name in WITH_FALSE_LOOPS:
        graph = read_g2o(data / f"{name}.g2o.gz")
        spoiled = tuple(add_false_loops(graph, "random", FALSE_LOOPS, seed).graph for seed in range(seeds))
        yield Case(f"{name}, {FALSE_LOOPS} false loops, dcs", spoiled, "dcs")


def measure(graph: PoseGraph, kernel: str, repeats: int) -> Measured:
    """Every start once, which compiles what there is to compile; then given and auto in turns."""
    found = {start: optimize_from(graph, start, kernel=kernel_of(kernel)) for start in STARTS}
    seconds: dict[str, list[float]] = {"given": [], "auto": []}
    for _ in range(repeats):
        for start, kept in seconds.items():
            began = time.perf_counter()
            optimize_from(graph, start, kernel=kernel_of(kernel))
            kept.append(time.perf_counter() - began)
    ratio = min(seconds["auto"]) / min(seconds["given"])
    costs = {start: one.result.cost_final for start, one in found.items()}
    return Measured(costs, found["auto"].taken, len(found["auto"].ends), ratio)


def row(case: Case, measured: list[Measured]) -> tuple[str, ...]:
    costs = [f"{statistics.median(one.costs[start] for one in measured):,.1f}" for start in STARTS]
    count = len(measured)
    counts = (
        sum(one.taken == "chordal" for one in measured),
        sum(one.tried > 1 for one in measured),
        sum(one.missed for one in measured),
    )
    shares = [f"{number} of {count}" for number in counts]
    return (case.name, *costs, *shares, f"{statistics.median(one.ratio for one in measured):.2f}")


if __name__ == "__main__":
    main()
