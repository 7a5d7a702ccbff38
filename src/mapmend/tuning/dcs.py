"""The kernel's parameter that gives the most consistent map, MC section V.

M(phi), MC (11), is the average of M_ij over the overlapping pairs of scans of the map that the kernel gives with phi.
The pairs are the same for all phi: all pairs of scans, of which those that do not overlap contribute nothing; and the
number that the sum is divided by is the same too, that of the pairs that overlap at phi*. Were both to change with phi
(as in print), a map could lower its average by bringing scans together that see nothing in common; were only the pairs
counted that overlap at the start, scans that a false loop brings together would contradict each other unseen.

M(phi) has no closed form and jumps wherever a loop is let go: it has several local minima. The search is the paper's,
a grid in sqrt(phi) over [0, 16] followed by bisection, MC (12), but around the lowest few local minima of the grid; and
the grid is finer near 0, where maps change fastest.

M is an average and may favour a few strong contradictions over many weak ones, as MC warns. So the map of least M is
put to the test of ``check``. Where it fails, the other valleys of M are asked too, the lowest first, and the first
whose map passes is taken: whoever tunes wants a map to drive by, and the answer "consistent" must be about the graph
that is given. The notes say so, and what M it costs. The price: one of several wrong maps passes more easily than one
alone, so few are asked. Where none passes, the map of least M is given, and said to be inconsistent.

Two things make it cheap. The search looks at a sample of the pairs, the same in all maps: it compares maps, and what
the sample misses is nearly the same in all; what it ends with is measured over all pairs. And within the sample a pair
is measured again only where it moved by more than a tolerance (``pair_sample``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.consistency.check import CheckResult, check
from mapmend.consistency.measure import measure_pairs
from mapmend.consistency.visibility import Views, build_views
from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import KERNELS, distrusted
from mapmend.graph.starts import starting_poses
from mapmend.parallel import Progress, no_progress
from mapmend.tuning.pair_sample import Evaluation, PairSample
from mapmend.tuning.solutions import Solution, solve

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Judged = list[tuple[float, CheckResult]]

DEFAULT_CONFIG = Config()
PUBLISHED_PHI = 1.0
"""What DCS is published with; its map is kept for comparison."""

LARGEST_ROOT = 4.0
"""The grid ends at phi = 16, MC Figure 4."""

GRID_STEPS = 64
FINE_STEPS, FINE_BELOW = 4, 4
"""The first FINE_BELOW steps of the grid are cut into so many each: MC's phi* are mostly between 0.003 and 0.016."""

COARSE = 8
"""Every so manieth value of the grid comes first: the least M of these says what M may be off by."""

ROUNDS = 5
"""Bisections of a step of the grid; the last one ends within 0.002 of sqrt(phi)."""

MOST_MINIMA, MINIMA_WITHIN = 3, 0.02
"""So many local minima of the grid are looked into, if their M is at most this share above the least."""

SAMPLED_POINTS = 10_000_000
"""The sample's pairs have so many end points in all at most: 28,000 pairs of scans of 180 beams."""

TOLERANCE = 0.01
"""The share of M by which a sum may be off at most for pairs that were not measured again. Points move to and fro, and
what this leaves out is a hundredth of the bound (``benchmarks/tuning.py --what shortcut``)."""


VALLEY_DEPTH = 0.002
MOST_CHECKED = 5
"""Where the map of least M fails the check, so many minima of M are checked, that one included, if they are valleys:
if M rises by this share to both sides before it falls below them."""


class Verdict(NamedTuple):
    """What ``check`` says of the map at phi, whose M the curve has at ``measure_m``."""

    phi: float
    measure_m: float
    p_value: float
    consistent: bool


@dataclass(frozen=True)
class TuneResult:
    """``phi``: of the map that is taken; ``measure_m``: its M, metres, over all ``overlapping`` pairs.

    ``least_phi`` is phi* of MC (12), where M is least. It is ``phi`` too, unless its map fails the check and that of
    another minimum passes, ``verdicts``: the maps that were checked, the least M first.
    ``curve_phi``, ``curve_m``: (f,), the values looked at, rising, and their M as the sample has it, scaled so that
    that of ``phi`` is ``measure_m``. ``sampled``: the share of the pairs in the sample. ``curve_bound``: the share of M
    by which the curve may be off for pairs that were not measured again; ``measured`` of ``asked`` pairs were.
    ``graph``: at ``phi``; ``published``: at 1. ``edge_weights``: (m,), the kernel's at ``phi``; ``switched_off``: rows
    of the edges that it distrusts. ``check``: the verdict on ``graph``. ``notes``: what had to be assumed.
    """

    kernel: str
    phi: float
    measure_m: float
    overlapping: int
    least_phi: float
    curve_phi: Float
    curve_m: Float
    curve_bound: float
    sampled: float
    measured: int
    asked: int
    graph: PoseGraph
    published: PoseGraph
    edge_weights: Float
    switched_off: Int
    check: CheckResult
    verdicts: tuple[Verdict, ...]
    notes: tuple[str, ...]

    @property
    def consistent(self) -> bool:
        return self.check.consistent

    def measure_at(self, phi: float) -> float | None:
        """M as the curve has it at a value that was looked at, metres; None at any other."""
        at = np.flatnonzero(self.curve_phi == phi)
        return float(self.curve_m[at[0]]) if len(at) else None


@dataclass
class _Search:
    """What was looked at so far: roots of phi, their solutions and sums over the sample."""

    start: PoseGraph
    kernel: str
    sample: PairSample
    threads: int
    progress: Progress
    tolerance_m: float = 0.0
    solutions: dict[float, Solution] = field(default_factory=dict)
    sums_m: dict[float, float] = field(default_factory=dict)
    bounds_m: dict[float, float] = field(default_factory=dict)
    overlapping: dict[float, int] = field(default_factory=dict)
    refusals: dict[float, MapmendError] = field(default_factory=dict)
    measured: int = 0
    asked: int = 0

    def look_at(self, roots: list[float], stage: str) -> None:
        """Solves and measures for those roots of phi that are new."""
        new = [r for r in roots if r not in self.sums_m and r not in self.refusals]
        if not new:
            return
        solved = solve(
            self.start,
            self.kernel,
            [r * r for r in new],
            threads=self.threads,
            stage=f"{stage}: solve",
            progress=self.progress,
        )
        found = {r: s for r, s in zip(new, solved, strict=True) if isinstance(s, Solution)}
        self.refusals |= {r: s for r, s in zip(new, solved, strict=True) if isinstance(s, MapmendError)}
        if not found:
            return
        evaluation = self.sample.evaluate(
            [s.poses for s in found.values()],
            self.tolerance_m,
            threads=self.threads,
            stage=f"{stage}: measure",
            progress=self.progress,
        )
        self._keep(found, evaluation)

    def _keep(self, found: dict[float, Solution], evaluation: Evaluation) -> None:
        self.solutions |= found
        roots = list(found)
        self.sums_m |= dict(zip(roots, evaluation.sum_m.tolist(), strict=True))
        self.bounds_m |= dict(zip(roots, evaluation.bound_m.tolist(), strict=True))
        self.overlapping |= dict(zip(roots, evaluation.overlapping.tolist(), strict=True))
        self.measured += evaluation.measured
        self.asked += evaluation.asked

    def rising(self) -> list[float]:
        return sorted(self.sums_m)

    def least(self) -> float:
        """The root of least sum; of equal ones the largest, which trusts the loops most."""
        return min(self.sums_m, key=lambda r: (self.sums_m[r], -r))


def tune(
    graph: PoseGraph,
    config: Config = DEFAULT_CONFIG,
    *,
    kernel: str = "dcs",
    init: str = "odometry",
    threads: int = 1,
    progress: Progress = no_progress,
) -> TuneResult:
    """The value of the kernel's phi in [0, 16] that makes the graph's map most consistent, MC (11) and (12).

    ``init``: where every solve starts (``graph.starts.STARTS``). The result is the same for any number of threads.
    Raises MapmendError for a graph without loop edges, one with fewer than two scans, kernels and starts that there are
    not, and graphs that can't be optimized.
    """
    scans = graph.scans
    if kernel not in KERNELS:
        raise MapmendError(f"kernel must be one of {', '.join(KERNELS)}, got {kernel!r}")
    with_scans = 0 if scans is None else int(np.count_nonzero(np.diff(scans.offsets)))
    if scans is None or with_scans < 2:
        raise MapmendError(f"{with_scans} of {len(graph)} nodes carry a scan; tuning compares at least two")
    if not graph.is_loop.any():
        raise MapmendError("the graph has no loop edges that a kernel could doubt")
    start = graph.with_poses(starting_poses(graph, init))
    views = build_views(scans, start.poses, config.consistency)
    search = _Search(start, kernel, sample_of(graph, views), threads, progress)
    grid = grid_roots()
    search.look_at(grid[::COARSE], "grid")
    if not search.sums_m:
        raise next(iter(search.refusals.values()))
    search.tolerance_m = TOLERANCE * min(search.sums_m.values()) / max(len(search.sample.pairs), 1)
    search.look_at(grid, "grid")
    _bisect(search)
    return _result(graph, config, search)


def grid_roots() -> list[float]:
    """The values of sqrt(phi) that are always looked at, rising."""
    step = LARGEST_ROOT / GRID_STEPS
    fine = [k * step / FINE_STEPS for k in range(FINE_BELOW * FINE_STEPS)]
    return [*fine, *(k * step for k in range(FINE_BELOW, GRID_STEPS + 1))]


def average_measure(
    graph: PoseGraph, config: Config = DEFAULT_CONFIG, threads: int = 1, progress: Progress = no_progress
) -> tuple[float, int]:
    """M of MC (11) of a map as it stands, metres, over all pairs that overlap, and their number."""
    assert graph.scans is not None
    views = build_views(graph.scans, graph.poses, config.consistency)
    measures = measure_pairs(views, 1, threads=threads, progress=progress)
    return float(measures.measure_m.sum()) / max(measures.overlapping, 1), measures.overlapping


def sample_of(graph: PoseGraph, views: Views) -> PairSample:
    """Every so manieth pair, such that those that overlap where the graph stands have SAMPLED_POINTS at most."""
    from mapmend.consistency.pairs import find_overlaps

    assert graph.scans is not None
    here = find_overlaps(views.boxes).total
    points = here * 2.0 * len(views.points) / max(len(views), 1)
    stride = 1
    while points > stride * SAMPLED_POINTS:
        stride *= 2
    return PairSample(graph.scans, views, stride)


def minima(roots: list[float], sums_m: dict[float, float]) -> list[float]:
    """The local minima worth a closer look, the lowest first; ``sums_m``: of each root, metres."""
    values = np.array([np.inf, *(sums_m[r] for r in roots), np.inf])
    low = (values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])
    enough = values[1:-1] <= (1.0 + MINIMA_WITHIN) * values.min()
    chosen = [r for r, yes in zip(roots, (low & enough).tolist(), strict=True) if yes]
    return sorted(chosen, key=lambda r: (sums_m[r], -r))[:MOST_MINIMA]


def valleys(sums_m: dict[float, float]) -> list[float]:
    """The roots of the curve's local minima that are worth a check, the lowest first: MOST_CHECKED at most.

    Dips less deep than VALLEY_DEPTH of the least M are the same map, or as good as that.
    """
    from scipy.signal import find_peaks

    roots = np.array(sorted(sums_m))
    values = np.array([sums_m[r] for r in roots.tolist()])
    outside = 2.0 * values.max() + 1.0
    heights = -np.concatenate(([outside], values, [outside]))
    dips = find_peaks(heights, prominence=VALLEY_DEPTH * values.min())[0] - 1
    least = min(sums_m, key=lambda r: (sums_m[r], -r))
    others = sorted((r for r in roots[dips].tolist() if sums_m[r] > sums_m[least]), key=lambda r: sums_m[r])
    return [least, *others][:MOST_CHECKED]


def _bisect(search: _Search) -> None:
    """MC (12): halves the step to both sides of each of the lowest minima, and goes on with the best of the three."""
    roots = search.rising()
    middles = minima(roots, search.sums_m)
    steps = [max(abs(r - m) for r in _neighbours(m, roots)) for m in middles]
    for _ in range(ROUNDS):
        steps = [step / 2.0 for step in steps]
        around = [
            [r for r in (m - step, m, m + step) if 0.0 <= r <= LARGEST_ROOT]
            for m, step in zip(middles, steps, strict=True)
        ]
        search.look_at(sorted({r for three in around for r in three}), "bisect")
        middles = [
            min((r for r in three if r in search.sums_m), key=lambda r: (search.sums_m[r], -r)) for three in around
        ]


def _neighbours(root: float, roots: list[float]) -> list[float]:
    at = roots.index(root)
    return [roots[max(at - 1, 0)], roots[min(at + 1, len(roots) - 1)]]


def _result(graph: PoseGraph, config: Config, search: _Search) -> TuneResult:
    """The map that is taken, measured over all pairs, and the verdict on it, as MC advises."""
    roots, least = search.rising(), search.least()
    best, verdict, verdicts = _judge(graph, config, search)
    solution = search.solutions[best]
    tuned = graph.with_poses(solution.poses)
    measure_m, overlapping = average_measure(tuned, config, search.threads, search.progress)
    sums = np.array([search.sums_m[r] for r in roots])
    of_best, of_least = search.sums_m[best], search.sums_m[least]
    bound = max(search.bounds_m[r] / search.sums_m[r] for r in roots if search.sums_m[r] > 0.0) if of_least else 0.0
    scale = measure_m / of_best if of_best else 1.0
    published = search.solutions.get(PUBLISHED_PHI, solution)
    return TuneResult(
        kernel=search.kernel,
        phi=best * best,
        measure_m=measure_m,
        overlapping=overlapping,
        least_phi=least * least,
        curve_phi=np.array(roots) ** 2,
        curve_m=sums * scale,
        curve_bound=bound,
        sampled=1.0 / search.sample.stride,
        measured=search.measured,
        asked=search.asked,
        graph=tuned,
        published=graph.with_poses(published.poses),
        edge_weights=solution.edge_weights,
        switched_off=distrusted(solution.edge_weights),
        check=verdict,
        verdicts=tuple(Verdict(r * r, search.sums_m[r] * scale, v.p_value, v.consistent) for r, v in verdicts),
        notes=(*_notes(search, best, verdicts), *verdict.notes),
    )


def _judge(graph: PoseGraph, config: Config, search: _Search) -> tuple[float, CheckResult, Judged]:
    """The root of the map that is taken, the verdict on it, and those on all that were checked.

    The valleys of M are checked, the lowest first, until one passes. Where none does, the lowest is taken.
    """
    judged: Judged = []
    for root in valleys(search.sums_m):
        tuned = graph.with_poses(search.solutions[root].poses)
        verdict = check(tuned, config.consistency, threads=search.threads, progress=search.progress)
        judged.append((root, verdict))
        if verdict.consistent:
            return root, verdict, judged
    return *judged[0], judged


def _notes(search: _Search, best: float, judged: Judged) -> list[str]:
    """What had to be assumed, and why the map taken is not the one of least M, if it is not."""
    notes = []
    if search.refusals:
        most = max(search.refusals)
        notes.append(f"{len(search.refusals)} values of phi up to {most * most:g} gave no map: {search.refusals[most]}")
    least = search.least()
    if least == LARGEST_ROOT:
        notes.append(f"M is least where the range of phi ends, at {LARGEST_ROOT**2:g}: larger ones were not tried")
    if best != least:
        more = search.sums_m[best] / search.sums_m[least] - 1.0
        notes.append(
            f"M is least at phi = {least**2:.4g}, but that map contradicts itself (p = {judged[0][1].p_value:.3g}); "
            f"taken is the lowest minimum of M whose map passes the check: its M is {more:.1%} higher"
        )
    return notes
