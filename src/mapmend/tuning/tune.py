"""The kernel's parameter that gives the most consistent map, MC section V.

M(phi), MC (11), is the average of M_ij over the overlapping pairs of scans of the map that the kernel gives with phi.
The pairs are the same for all phi: all pairs of scans, of which those that do not overlap contribute nothing; and the
divisor of the sum is the same too, the number of pairs that overlap at phi*. If both changed with phi (as printed in
the paper), a map could lower its average by bringing scans together that see no common surface. If only the pairs
counted that overlap at the start, contradictions between scans that a false loop brings together would be missed.

M(phi) has no closed form and jumps wherever a loop is switched off: it has many local minima. The search (``search``)
is the paper's, a grid in sqrt(phi) over [0, 16] and halvings, MC (12), but the halvings are made wherever M is low, and
the grid is finer near 0, where maps change fastest.

M is an average and may favour a few strong contradictions over many weak ones, as MC warns. So ``check`` tests the map
of least M. If it fails, the other valleys of M are tested too, the lowest first, and the first whose map passes is
taken: the user wants a usable map, and the answer "consistent" must be about the graph that is returned. The notes say
so, with the increase in M. The price: one of several wrong maps passes more easily than a single one, so only few are
tested. If none passes, the map of least M is returned, as inconsistent.

Two things save time. The search compares maps on a sample of the pairs, the same in all maps: the part of M outside the
sample is nearly the same in all of them. The M of the result is measured over all pairs. And within the sample a pair
is measured again only if it moved by more than a tolerance (``pair_sample``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config, require_config
from mapmend.consistency.check import Basis, CheckResult, basis_of, judge_map
from mapmend.consistency.measure import measure_pairs
from mapmend.consistency.pairs import find_overlaps
from mapmend.consistency.views import PlacedViews
from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import KERNELS, distrusted
from mapmend.graph.starts import starting_poses
from mapmend.parallel import Progress, no_progress
from mapmend.tuning.pair_sample import PairSample
from mapmend.tuning.search import COARSE, LARGEST_ROOT, ONE_MAP, Search, grid_roots, halve, valleys

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Judged = list[tuple[float, CheckResult]]

DEFAULT_CONFIG = Config()
PUBLISHED_PHI = 1.0
"""The value with which DCS was published; its map is kept for comparison."""

SAMPLED_POINTS = 10_000_000
"""The greatest number of end points in the pairs of the sample: 28,000 pairs of scans of 180 beams."""

TOLERANCE = 0.01
"""The share of M by which a sum may be off at most for pairs that were not measured again. Points move back and forth,
and the true error is a hundredth of this bound (``benchmarks/tuning.py --what shortcut``)."""


MOST_CHECKED = 5
"""How many valleys of M are checked at most, the lowest one included, if the map of least M fails the check."""


class Verdict(NamedTuple):
    """The verdict of ``check`` on the map at phi; ``measure_m``: its M on the curve."""

    phi: float
    measure_m: float
    p_value: float
    consistent: bool


@dataclass(frozen=True)
class TuneResult:
    """``phi``: of the map that is taken; ``measure_m``: its M, metres, over all ``overlapping`` pairs.

    ``least_phi`` is phi* of MC (12), where M is least. It is ``phi`` too, unless its map fails the check and that of
    another minimum passes. ``verdicts``: on the maps that were checked, that of least M first.

    ``curve_phi``, ``curve_m``: (f,), the values that were tried, sorted, and their M in the sample, scaled so that that
    of ``phi`` is ``measure_m``; by errors of the sample, another one may be a little lower. ``sampled``: the share of
    the pairs in the sample. ``curve_bound``: the share of M by which the curve may be off for pairs that were not
    measured again; ``measured`` of ``asked`` pairs were measured.

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
        """M of the curve at a value that was tried, metres; None at any other value."""
        at = np.flatnonzero(self.curve_phi == phi)
        return float(self.curve_m[at[0]]) if len(at) else None


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

    ``init``: where every solution starts (``graph.starts.STARTS``). The result is the same for any number of threads.
    Raises MapmendError for a graph without loop edges or with fewer than two scans, for unknown kernels and starts, and
    for graphs that cannot be optimized.
    """
    require_config(config)
    scans = graph.scans
    if kernel not in KERNELS:
        raise MapmendError(f"kernel must be one of {', '.join(KERNELS)}, got {kernel!r}")
    with_scans = 0 if scans is None else int(np.count_nonzero(np.diff(scans.offsets)))
    if scans is None or with_scans < 2:
        what = f"{with_scans} of {len(graph)} nodes carry a scan; tuning compares at least two"
        raise MapmendError(f"{what}: name a graph whose nodes carry their scans")
    if not graph.is_loop.any():
        raise MapmendError("the graph has no loop edges that a kernel could doubt; name one that has")
    start = graph.with_poses(starting_poses(graph, init))
    basis = basis_of(start, config.consistency, threads=threads, progress=progress)
    search = Search(start, kernel, sample_of(basis.views.placed(start.poses)), threads, progress)
    grid = grid_roots()
    search.look_at(grid[::COARSE], "grid")
    if not search.sums_m:
        raise next(iter(search.refusals.values()))
    search.tolerance_m = TOLERANCE * min(search.sums_m.values()) / max(len(search.sample.pairs), 1)
    search.look_at(grid, "grid")
    halve(search)
    least = search.least()
    judged = _judge(search, least, basis, config)
    best = next((root for root, verdict in judged if verdict.consistent), least)
    measured = average_measure(basis.views.placed(search.map_at(best).poses), threads, progress)
    return _result(search, least, best, measured, judged)


def average_measure(views: PlacedViews, threads: int = 1, progress: Progress = no_progress) -> tuple[float, int]:
    """M of MC (11) of a map, metres, over all pairs of scans that overlap in it, and their number."""
    measures = measure_pairs(views, 1, threads=threads, progress=progress)
    return float(measures.measure_m.sum()) / max(measures.overlapping, 1), measures.overlapping


def sample_of(views: PlacedViews) -> PairSample:
    """Every n-th pair of scans, n such that those which overlap in this map have at most SAMPLED_POINTS end points."""
    here = find_overlaps(views.boxes()).total
    points = here * 2.0 * len(views.scans.points.xy) / max(len(views), 1)
    stride = 1
    while points > stride * SAMPLED_POINTS:
        stride *= 2
    return PairSample(views.scans, stride)


def _judge(search: Search, least: float, basis: Basis, config: Config) -> Judged:
    """The verdicts on the valleys of M, with their roots: that of the root ``least`` first, until one passes."""
    judged: Judged = []
    for root in valleys(search.sums_m, least)[:MOST_CHECKED]:
        graph = search.map_at(root)
        verdict = judge_map(graph, basis, config.consistency, threads=search.threads, progress=search.progress)
        judged.append((root, verdict))
        if verdict.consistent:
            break
    return judged


def _result(search: Search, least: float, best: float, measured: tuple[float, int], judged: Judged) -> TuneResult:
    """``least``: the root of least M; ``best``: that of the map that is taken; ``measured``: its M and its pairs."""
    roots, sums_m, solution = sorted(search.sums_m), search.sums_m, search.solutions[best]
    scale = measured[0] / sums_m[best] if sums_m[best] else 1.0
    verdict = dict(judged)[best]
    published = PUBLISHED_PHI**0.5
    return TuneResult(
        kernel=search.kernel,
        phi=best * best,
        measure_m=measured[0],
        overlapping=measured[1],
        least_phi=least * least,
        curve_phi=np.array(roots) ** 2,
        curve_m=np.array([sums_m[r] for r in roots]) * scale,
        curve_bound=max((search.bounds_m[r] / sums_m[r] for r in roots if sums_m[r] > 0.0), default=0.0),
        sampled=1.0 / search.sample.stride,
        measured=search.measured,
        asked=search.asked,
        graph=search.map_at(best),
        published=search.map_at(published if published in search.solutions else best),
        edge_weights=solution.edge_weights,
        switched_off=distrusted(solution.edge_weights),
        check=verdict,
        verdicts=tuple(Verdict(r * r, sums_m[r] * scale, v.p_value, v.consistent) for r, v in judged),
        notes=(*_notes(search, least, best, judged), *verdict.notes),
    )


def _notes(search: Search, least: float, best: float, judged: Judged) -> list[str]:
    """What had to be assumed, and why the map taken is not the one of least M, if it is not."""
    notes = []
    if search.refusals:
        most = max(search.refusals)
        notes.append(f"{len(search.refusals)} values of phi up to {most * most:g} gave no map: {search.refusals[most]}")
    below = [m for r, m in search.sums_m.items() if r < LARGEST_ROOT]
    if least == LARGEST_ROOT and below and min(below) > (1.0 + ONE_MAP) * search.sums_m[least]:
        notes.append(f"M is least where the range of phi ends, at {LARGEST_ROOT**2:g}: larger ones were not tried")
    if best != least:
        more = search.sums_m[best] / search.sums_m[least] - 1.0
        notes.append(
            f"M is least at phi = {least**2:.4g}, but that map contradicts itself (p = {judged[0][1].p_value:.3g}); "
            f"taken is the lowest minimum of M whose map passes the check: its M is {more:.1%} higher"
        )
    return notes
