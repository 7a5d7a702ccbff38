"""The optimum from one start, or from the better of two.

Gauss-Newton ends in a local optimum, which depends on where it starts: M3500a ends at chi2 = 6,938 from its odometry
and at 912 from the chordal start. ``auto`` optimizes from the given poses first. If that end looks poor, it tries the
chordal start for a few steps. If its cost is then below that of the first end, it is optimized to its own end. The
end of lower cost is kept.

An end looks poor if it has not converged, or if one of two tests of the residuals fails. If the stated covariances are
right and all edges are true, chi2 follows a chi-square distribution whose degrees of freedom are the numbers measured
less the numbers estimated, 3 (edges - free nodes); the first test compares chi2 with its ``1 - FALSE_ALARMS`` quantile.
The second compares the largest chi2 of an edge with the ``1 - FALSE_ALARMS / edges`` quantile of three degrees of
freedom (Bonferroni's bound). Published graphs often state their covariances too wide (M3500's best chi2 is 138, with
5,862 degrees of freedom), and then the first test says nothing. So the second test scales the covariances by
chi2 / degrees of freedom where this is below 1: a local optimum strains some edges much more than the others, whatever
the scale. That is data snooping with the a posteriori variance factor (Pope, "The statistics of residuals and the
detection of outliers", NOAA 1976).

If a good end fails a test, or if loops are false, the chordal start and its few steps are computed in vain, and the
result is that of the given poses.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from mapmend.errors import MapmendError
from mapmend.graph.optimizer import DEFAULT_SETTINGS, OptimizationResult, OptimizerSettings, edge_chi2, optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import GraduatedNonConvexity, Kernel, TruncatedQuadratic
from mapmend.graph.starts import STARTS, starting_poses
from mapmend.graph.system import System
from mapmend.parallel import Progress, no_progress

AUTO = "auto"
INITS = (AUTO, *STARTS)
FIRST, SECOND = "given", "chordal"
"""What ``auto`` tries, in this order; ``benchmarks/starts.py`` compares the starts."""

FALSE_ALARMS = 0.01
"""The share of graphs with right covariances and true edges that fail each test."""

LEAST_SCALE = 1e-6
"""Residuals of less than a thousandth of their standard deviations are no reason to look for another end: no other end
could be noticeably better."""

TRIAL_STEPS = 5
"""So many steps from the chordal start decide whether it is optimized to its end. The public graphs without false loops
converge from there in 3 to 8 steps. With 100 false loops, the descent takes far longer and its end is not taken: with
dcs on intel, a whole second descent took 33 times as long as the first."""

SAME_OPTIMUM = 1e-6
"""Two ends are the same optimum if their costs differ by less than this share: each descent stops a little above its
optimum (``OptimizerSettings.tolerance_share``)."""


@dataclass(frozen=True)
class End:
    """The end of one descent: ``chi2_start`` and ``chi2`` of all edges; ``cost``: what was minimized, at the end.

    ``given_up``: the descent was stopped after ``TRIAL_STEPS``, because its cost was still above that of the other end.
    """

    start: str
    chi2_start: float
    chi2: float
    cost: float
    iterations: int
    converged: bool
    given_up: bool = False


@dataclass(frozen=True)
class StartedResult:
    """``result`` is that from the start ``taken``; ``ends``: those of all starts tried, in their order.

    ``seconds``: "analyse" for checks and pattern, "start" for the starting poses, "solve" for all descents.
    """

    result: OptimizationResult
    taken: str
    ends: tuple[End, ...]
    seconds: dict[str, float]


def optimize_from(
    graph: PoseGraph,
    init: str = AUTO,
    settings: OptimizerSettings = DEFAULT_SETTINGS,
    progress: Progress = no_progress,
    *,
    kernel: Kernel | None = None,
    doubted: NDArray[np.bool_] | None = None,
    threads: int = 1,
) -> StartedResult:
    """The optimum from the start ``init``, one of ``INITS``; the fixed nodes stay.

    ``kernel``, ``doubted``: as for ``optimizer.optimize``; with a kernel the ends are compared by its cost. Raises
    ``MapmendError`` for other starts, for graphs that can't be optimized, and where the graph lacks the start.
    """
    if init not in INITS:
        raise MapmendError(f"the start must be one of {', '.join(INITS)}, got {init!r}")
    descents = _Descents(graph, progress, doubted, threads)
    first = FIRST if init == AUTO else init
    result = descents.run(descents.at(first), settings, kernel)
    ends = [_end(first, result)]
    if init != AUTO or not looks_poor(graph, result):
        return StartedResult(result, first, tuple(ends), descents.seconds)
    begun = descents.at(SECOND)
    trial_kernel = TruncatedQuadratic(kernel.phi) if isinstance(kernel, GraduatedNonConvexity) else kernel
    brief = replace(settings, max_iterations=min(TRIAL_STEPS, settings.max_iterations))
    other = descents.run(begun, brief, trial_kernel)
    promises = other.cost_final < result.cost_final * (1.0 - SAME_OPTIMUM)
    if promises:
        other = descents.run(begun, settings, kernel)
    ends.append(_end(SECOND, other, given_up=not promises and not other.converged))
    if promises and other.cost_final < result.cost_final * (1.0 - SAME_OPTIMUM):
        return StartedResult(other, SECOND, tuple(ends), descents.seconds)
    return StartedResult(result, FIRST, tuple(ends), descents.seconds)


class _Descents:
    """Descents over the same edges; adds up their seconds."""

    def __init__(self, graph: PoseGraph, progress: Progress, doubted: NDArray[np.bool_] | None, threads: int) -> None:
        self._graph, self._progress, self._doubted = graph, progress, doubted
        began = time.perf_counter()
        self._system = System(graph, threads)
        self.seconds = {"analyse": time.perf_counter() - began, "start": 0.0, "solve": 0.0}

    def at(self, start: str) -> PoseGraph:
        """The graph at the poses of a start."""
        began = time.perf_counter()
        begun = self._graph.with_poses(starting_poses(self._graph, start, self._system))
        self.seconds["start"] += time.perf_counter() - began
        return begun

    def run(self, begun: PoseGraph, settings: OptimizerSettings, kernel: Kernel | None) -> OptimizationResult:
        """The descent from the graph's poses."""
        result = optimize(begun, settings, self._progress, system=self._system, kernel=kernel, doubted=self._doubted)
        for name in ("analyse", "solve"):
            self.seconds[name] += result.seconds[name]
        return result


def _end(start: str, result: OptimizationResult, given_up: bool = False) -> End:
    return End(
        start,
        result.chi2_initial,
        result.chi2_final,
        result.cost_final,
        result.iterations,
        result.converged,
        given_up,
    )


def looks_poor(graph: PoseGraph, result: OptimizationResult) -> bool:
    """Whether ``result`` has not converged, or its residuals fail one of the two tests above."""
    if not result.converged:
        return True
    edges, free = len(graph.edges), len(graph) - len(set(graph.fixed))
    degrees = 3 * (edges - free)
    if degrees <= 0 or result.cost_final < LEAST_SCALE * degrees:
        return False
    largest = edge_chi2(graph.with_poses(result.poses)).max()
    allowed = min(1.0, result.cost_final / degrees) * chdtri(3, FALSE_ALARMS / edges)
    return bool(result.cost_final > chdtri(degrees, FALSE_ALARMS) or largest > allowed)
