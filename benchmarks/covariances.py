"""Whether the covariances say the truth, on simulated drives: the normalized estimation error squared (NEES).

For covariances that are right, the mean over n independent errors of three axes lies in its band with probability
0.95; below it they are too large, above it too small. Neighbouring odometry edges share a node's matching noise, so
the pooled bands are somewhat narrow. The marginals of one run are almost wholly dependent (one bent corridor moves all
behind it): each run's mean counts as ONE sample of a chi-square with 3 degrees of freedom, and the band is that of as
many samples as there are runs. For errors that are wholly dependent that is exact; for others it is too wide.

With --beams or --noises, lasers that look half a circle ahead drive through random buildings, one row a laser: the mean
NEES over 3, the degrees of freedom, which is 1 for covariances that are right. Its band, 0.6 to 1.6, is that of
standard deviations that are right within a factor of 1.3: of true loops, 7 % then lie beyond the gate's 99 % quantile
at most. For node marginals it is wider where chance leaves more: each drive is one sample, so with probability 0.95
four drives lie within 0.37 and 1.94, and ten within 0.56 and 1.57.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from _measure import markdown
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.front_end.builder import FrontEnd
from mapmend.geometry import se2
from mapmend.graph.marginals import marginals
from mapmend.graph.optimizer import optimize
from mapmend.lab.nees import mean_nees_band, normalized_errors, pose_errors
from mapmend.scan import LaserGeometry
from mapmend.simulation import LaserModel, World, corridor_loop, office_floor, random_building, simulate

Float = NDArray[np.float64]

WORLDS: dict[str, Callable[[int], World]] = {
    "office floor": lambda _seed: office_floor(),
    "random building": random_building,
    "corridor loop": lambda _seed: corridor_loop(),
}
HOLDS = ("office floor", "random building")
BEAMS, NOISES_M = (91, 181, 361, 721, 1441), (0.005, 0.01, 0.02, 0.03)
LASER_RANGE_M = 16.0
# The mean NEES over 3 of covariances that are right, within reason.
LOWEST, HIGHEST = 0.6, 1.6
LASER_HEAD = ("beams", "noise [m]", "drives", "odometry edges", "loop edges", "node marginals", "out of the band")
HEAD = (
    "worlds",
    "what",
    "samples",
    "mean NEES",
    "95 % band",
    "median",
    "in the band",
    "variance x, y, θ",
    "lag 1 x, y, θ",
)


@dataclass(frozen=True)
class Errors:
    """Errors (n, 3) of estimates and what the covariances (n, 3, 3) make of them."""

    errors: Float
    covariances: Float

    @property
    def nees(self) -> Float:
        return normalized_errors(self.errors, self.covariances)

    @property
    def per_axis(self) -> Float:
        """Each axis by its own standard deviation, shape (n, 3)."""
        return self.errors / np.sqrt(np.einsum("nii->ni", self.covariances))


@dataclass(frozen=True)
class Drive:
    """What one simulated drive was mapped to, beside the truth."""

    odometry: Errors
    loops: Errors
    marginals: Errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="drives a world (default: 5)")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first drive (default: 0)")
    parser.add_argument("--beams", type=int, nargs="+", metavar="N", help=f"of half a circle (default: {BEAMS})")
    parser.add_argument("--noises", type=float, nargs="+", metavar="M", help=f"of a range (default: {NOISES_M})")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    if options.beams or options.noises:
        print(markdown(LASER_HEAD, []), flush=True)
        for beams in options.beams or BEAMS:
            for noise_m in options.noises or NOISES_M:
                print(f"| {' | '.join(laser_row(beams, noise_m, seeds))} |", flush=True)
        return
    drives = {name: [drive(world(seed), seed) for seed in seeds] for name, world in WORLDS.items()}
    rows = []
    for name in WORLDS:
        rows += table_rows(name, drives[name])
        if name == HOLDS[-1]:
            rows += table_rows("**both**", [one for each in HOLDS for one in drives[each]])
    print(markdown(HEAD, rows))


def laser_row(beams: int, noise_m: float, seeds: range) -> tuple[str, ...]:
    """What covariances of one laser are worth, over a random building a seed; a mean beside its median's."""
    geometry = LaserGeometry(beams, -np.pi / 2.0, np.pi / (beams - 1), LASER_RANGE_M)
    drives = [drive(random_building(seed), seed, LaserModel(geometry, noise_m)) for seed in seeds]
    kinds = [[one.odometry for one in drives], [one.loops for one in drives], [one.marginals for one in drives]]
    cells, out = [], []
    for name, parts in zip(LASER_HEAD[3:6], kinds, strict=True):
        nees = np.concatenate([part.nees for part in parts]) / 3.0
        mean = float(nees.mean()) if len(nees) else float("nan")
        # The median of chi-square with 3 degrees of freedom is 2.37.
        cells.append(f"{mean:.2f} ({np.median(nees) * 3.0 / 2.366:.2f})" if len(nees) else "none")
        low, high = mean_nees_band(len(drives)) if parts is kinds[-1] else (3.0, 3.0)
        if not min(LOWEST, low / 3.0) <= mean <= max(HIGHEST, high / 3.0):
            out.append(name)
    return (f"{beams}", f"{noise_m:g}", f"{len(drives)}", *cells, ", ".join(out))


def drive(world: World, seed: int, laser: LaserModel | None = None) -> Drive:
    """Simulates and maps with defaults; errors of what was measured and of what the optimizer made of it."""
    simulation = simulate(world, laser, seed=seed)
    mapped = FrontEnd(simulation.log.scans.geometries, Config()).run(simulation.log)
    graph = mapped.pose_graph()
    truth = se2.between(simulation.truth[0], simulation.truth[mapped.hung.node_scan])
    true_edges = se2.between(truth[graph.edges[:, 0]], truth[graph.edges[:, 1]])
    errors = pose_errors(graph.measurements, true_edges)
    covariances = np.asarray(np.linalg.inv(graph.information))
    loop, neighbours = graph.is_loop, np.arange(len(graph.edges)) < len(graph) - 1
    optimized = optimize(graph)
    # Node 0 is fixed at the truth.
    nodes = Errors(pose_errors(optimized.poses, truth)[1:], marginals(optimized.factorization)[1:])
    odometry = Errors(errors[neighbours], covariances[neighbours])
    return Drive(odometry, Errors(errors[loop], covariances[loop]), nodes)


def table_rows(name: str, drives: list[Drive]) -> list[tuple[str, ...]]:
    """A row each for odometry edges, loop edges and marginals, pooled over drives."""
    edges, loops = [one.odometry for one in drives], [one.loops for one in drives]
    rows = [edge_row(name, "odometry edges", edges)]
    if any(len(one.errors) for one in loops):
        rows.append(edge_row(name, "loop edges", loops))
    means = np.array([one.marginals.nees.mean() for one in drives])
    low, high = mean_nees_band(len(means))
    runs = ", ".join(f"{mean:.2f}" for mean in means)
    mean = float(means.mean())
    count = f"{len(means)} runs: {runs}"
    cells = (count, f"{mean:.2f}", f"{low:.2f} to {high:.2f}", f"{np.median(means):.2f}", verdict(mean, low, high))
    return [*rows, (name, "node marginals", *cells, "", "")]


def edge_row(name: str, what: str, parts: list[Errors]) -> tuple[str, ...]:
    nees = np.concatenate([part.nees for part in parts])
    low, high = mean_nees_band(len(nees))
    variances = np.mean(np.concatenate([part.per_axis for part in parts]) ** 2, axis=0)
    mean = float(nees.mean())
    cells = (f"{len(nees)}", f"{mean:.2f}", f"{low:.2f} to {high:.2f}", f"{np.median(nees):.2f}")
    return (name, what, *cells, verdict(mean, low, high), three(variances), three(lag_one(parts)))


def lag_one(parts: list[Errors]) -> Float:
    """The correlation of each error with the next one of its drive, by axis, shape (3,)."""
    before = np.concatenate([part.per_axis[:-1] for part in parts])
    after = np.concatenate([part.per_axis[1:] for part in parts])
    return np.asarray((before * after).sum(axis=0) / np.sqrt((before**2).sum(axis=0) * (after**2).sum(axis=0)))


def verdict(mean: float, low: float, high: float) -> str:
    if mean < low:
        return "below: too wide"
    return "above: too narrow" if mean > high else "yes"


def three(values: Float) -> str:
    return ", ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    main()
