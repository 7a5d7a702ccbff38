"""The optimum from one start, or from the better of two.

Gauss-Newton ends in a local optimum, which depends on where it starts: M3500a ends at chi2 = 6,938 from its odometry
and at 912 from the chordal start. ``auto`` optimizes from the given poses first. If that end looks poor, it optimizes
from the chordal start too, and keeps the end of lower cost.

An end looks poor if it has not converged, or if it is unlikely under the covariances that the edges state. Two tests
decide that. If the covariances are right and all edges are true, chi2 follows a chi-square distribution whose degrees
of freedom are the numbers measured less the numbers estimated, 3 (edges - free nodes); and no edge has a chi2 above the
``1 - FALSE_ALARMS / edges`` quantile for three degrees of freedom, but for one graph in a hundred (Bonferroni's bound).
The second test is needed for graphs whose covariances are stated too wide, so that the sum says nothing: M3500's best
chi2 is 138, with 5,862 degrees of freedom.

A false alarm costs a second optimization and changes no result. Graphs whose covariances are too narrow, or that have
false loops, pay this each time. A graph whose covariances are far too wide may hide a poor end from both tests.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from mapmend.errors import MapmendError
from mapmend.graph.optimizer import DEFAULT_SETTINGS, OptimizationResult, OptimizerSettings, edge_chi2, optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import Kernel
from mapmend.graph.starts import STARTS, starting_poses
from mapmend.graph.system import System
from mapmend.parallel import Progress, no_progress

AUTO = "auto"
INITS = (AUTO, *STARTS)
TRIED = ("given", "chordal")
"""What ``auto`` tries, in this order; ``benchmarks/starts.py`` compares the starts."""

FALSE_ALARMS = 0.01
"""The share of graphs with right covariances and true edges that each test takes for poor."""

SAME_OPTIMUM = 1e-6
"""Two ends are the same optimum if their costs differ by less than this share: each descent stops a little above its
optimum (``OptimizerSettings.tolerance_share``)."""


@dataclass(frozen=True)
class End:
    """The end of one descent: ``chi2_start`` and ``chi2`` of all edges; ``cost``: what was minimized, at the end."""

    start: str
    chi2_start: float
    chi2: float
    cost: float
    iterations: int
    converged: bool


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
    began = time.perf_counter()
    system = System(graph, threads)
    seconds = {"analyse": time.perf_counter() - began, "start": 0.0, "solve": 0.0}
    results: list[OptimizationResult] = []
    starts = TRIED if init == AUTO else (init,)
    for start in starts:
        began = time.perf_counter()
        begun = graph.with_poses(starting_poses(graph, start, system))
        seconds["start"] += time.perf_counter() - began
        results.append(optimize(begun, settings, progress, system=system, kernel=kernel, doubted=doubted))
        seconds["analyse"] += results[-1].seconds["analyse"]
        seconds["solve"] += results[-1].seconds["solve"]
        if init == AUTO and not looks_poor(graph, results[-1]):
            break
    best = 0
    for k, result in enumerate(results):
        if result.cost_final < results[best].cost_final * (1.0 - SAME_OPTIMUM):
            best = k
    ends = tuple(
        End(start, r.chi2_initial, r.chi2_final, r.cost_final, r.iterations, r.converged)
        for start, r in zip(starts, results, strict=False)
    )
    return StartedResult(results[best], starts[best], ends, seconds)


def looks_poor(graph: PoseGraph, result: OptimizationResult) -> bool:
    """Whether ``result`` has not converged, or is unlikely under the covariances that the edges state."""
    if not result.converged:
        return True
    edges, free = len(graph.edges), len(graph) - len(set(graph.fixed))
    if edges == 0:
        return False
    degrees = max(3 * (edges - free), 1)
    largest = edge_chi2(graph.with_poses(result.poses)).max()
    return bool(result.cost_final > chdtri(degrees, FALSE_ALARMS) or largest > chdtri(3, FALSE_ALARMS / edges))
