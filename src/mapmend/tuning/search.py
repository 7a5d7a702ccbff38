"""The search for the least M(phi): a grid in the root of phi, and halvings wherever M is low.

M(phi) jumps wherever a loop is switched off: on intel's scan graph it goes up and down by a hundredth within steps of
0.001 of the root of phi, and which of many narrow minima is the least depends on the values that are tried. Bisection,
MC (12), follows one of them. So what it does around the grid's minimum is done wherever M is near the minimum: each
round halves the steps on both sides of the minimum, and all steps with an end that is low enough, unless M is the same
at both ends: then it is one map.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.parallel import Progress
from mapmend.tuning.pair_sample import EVERY_PAIR, Evaluation, PairSample
from mapmend.tuning.solutions import Solution, solve

LARGEST_ROOT = 4.0
"""The grid ends at phi = 16, MC Figure 4."""

GRID_STEPS = 64
FINE_STEPS, FINE_BELOW = 4, 4
"""Each of the first FINE_BELOW steps of the grid is cut into this many: MC's phi* are mostly between 0.003 and
0.016."""

COARSE = 8
"""Every n-th value of the grid is tried first: the least M of these determines the tolerance for M."""

ROUNDS = 5
"""Halvings of a step of the grid; the last one ends at steps of 0.002 of sqrt(phi)."""

LOW_WITHIN, SAME_WITHIN = 0.02, 0.002
"""A step is halved if M at one end is at most this share above the minimum, and differs from the other end's by more
than the second share."""

MOST_HALVED = 8
"""At most this many steps are halved in a round, the lowest first."""

FINALISTS, FINALIST_WITHIN, ONE_MAP = 3, 0.01, 1e-4
"""The lowest values of the sample are compared again in a larger one: at most this many, if their M is within this
share of the minimum and differs by that share from the other finalists'."""

LARGER = 4
"""The larger sample is this many times larger: the standard error of the difference between two maps of intel is up to
0.5 % of M in the sample, and up to 0.2 % in the larger one."""

VALLEY_DEPTH = 0.002
"""A minimum of the curve is a valley if M rises by this share of the least to both sides before it falls below it."""


@dataclass
class Search:
    """The values tried so far: roots of phi, their solutions and sums over the sample."""

    start: PoseGraph
    kernel: str
    sample: PairSample
    threads: int
    progress: Progress
    tolerance_m: float = 0.0
    solutions: dict[float, Solution] = field(default_factory=dict)
    sums_m: dict[float, float] = field(default_factory=dict)
    bounds_m: dict[float, float] = field(default_factory=dict)
    refusals: dict[float, MapmendError] = field(default_factory=dict)
    measured: int = 0
    asked: int = 0

    def look_at(self, roots: list[float], stage: str) -> None:
        """Solves and measures the new ones among these roots of phi."""
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
        self.measured += evaluation.measured
        self.asked += evaluation.asked

    def map_at(self, root: float) -> PoseGraph:
        """The graph with the poses found for a root that was tried."""
        return self.start.with_poses(self.solutions[root].poses)

    def least(self) -> float:
        """The root of least M: the finalist that is lowest in a larger sample."""
        roots = finalists(self.sums_m)
        if len(roots) == 1:
            return roots[0]
        larger = PairSample(self.sample.views, max(1, self.sample.stride // LARGER))
        found = larger.evaluate(
            [self.solutions[r].poses for r in roots],
            EVERY_PAIR,
            threads=self.threads,
            stage="compare",
            progress=self.progress,
        )
        return min(zip(found.sum_m.tolist(), [-r for r in roots], roots, strict=True))[-1]


def grid_roots() -> list[float]:
    """The values of sqrt(phi) that are always tried, sorted."""
    step = LARGEST_ROOT / GRID_STEPS
    fine = [k * step / FINE_STEPS for k in range(FINE_BELOW * FINE_STEPS)]
    return [*fine, *(k * step for k in range(FINE_BELOW, GRID_STEPS + 1))]


def halve(search: Search) -> None:
    """MC (12): tries values between the lowest ones, with smaller steps from round to round."""
    finest = LARGEST_ROOT / GRID_STEPS / 2**ROUNDS
    for _ in range(ROUNDS):
        search.look_at(steps_to_halve(search.sums_m, finest), "halve")


def steps_to_halve(sums_m: dict[float, float], finest: float) -> list[float]:
    """The middles of the steps that are halved, sorted; ``sums_m``: of each root, metres."""
    roots = sorted(sums_m)
    best = min(roots, key=lambda r: (sums_m[r], -r))
    least = sums_m[best]
    chosen = []
    for low, high in pairwise(roots):
        ends = sums_m[low], sums_m[high]
        is_low = min(ends) <= (1.0 + LOW_WITHIN) * least and abs(ends[0] - ends[1]) > SAME_WITHIN * least
        if high - low > 1.5 * finest and (is_low or best in (low, high)):
            chosen.append((min(ends), -low, (low + high) / 2.0))
    return sorted(middle for _, _, middle in sorted(chosen)[:MOST_HALVED])


def finalists(sums_m: dict[float, float]) -> list[float]:
    """The roots that are compared again in the larger sample, the lowest first.

    Of roots whose M is the same to ONE_MAP, only the largest is taken, which trusts the loops most.
    """
    least = min(sums_m.values())
    chosen: list[float] = []
    left = {r: m for r, m in sums_m.items() if m <= (1.0 + FINALIST_WITHIN) * least}
    while left and len(chosen) < FINALISTS:
        lowest = min(left.values())
        same = [r for r, m in left.items() if m <= lowest + ONE_MAP * least]
        chosen.append(max(same))
        left = {r: m for r, m in left.items() if r not in same}
    return chosen


def valleys(sums_m: dict[float, float], least: float) -> list[float]:
    """``least`` and the lowest roots of the curve's other valleys, the lowest first; with the largest root of all.

    Minima less deep than VALLEY_DEPTH are nearly the same map as their neighbours. The curve's end, where loops are
    trusted most, is mostly the end of a plateau, whose map would not be checked otherwise.
    """
    from scipy.signal import find_peaks

    roots = np.array(sorted(sums_m))
    values = np.array([sums_m[r] for r in roots.tolist()])
    deep, outside = VALLEY_DEPTH * values.min(), 2.0 * values.max() + 1.0
    dips = find_peaks(-np.concatenate(([outside], values, [outside])), prominence=deep)[0] - 1
    here = int(np.searchsorted(roots, least))
    others = []
    for dip in dips.tolist():
        between = values[min(dip, here) : max(dip, here) + 1].max()
        if between > max(values[dip], values[here]) + deep:
            others.append(float(roots[dip]))
    end = float(roots[-1])
    if end not in others and abs(sums_m[end] - sums_m[least]) > ONE_MAP * values.min():
        others.append(end)
    return [least, *sorted(others, key=lambda r: sums_m[r])]
