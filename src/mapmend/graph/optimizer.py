"""The back end: the poses that agree best with all measurements, by Gauss-Newton and Levenberg-Marquardt.

Minimizes ``chi2 = sum e^T Omega e`` with ``e = measurement^-1 * (X_i^-1 * X_j)`` read as a vector (x, y, wrapped
angle): g2o's convention, so that chi2 compares with what is published for its graphs. GTSAM takes the logarithm of
the same pose, which differs in the second order of e, and reports half the sum.

Undamped steps converge in a few iterations wherever the graph is sound, and reach the published optima of intel and
M3500 from odometry. With many false loops they wander: on Bicocca 25b without a threshold, Gauss-Newton still stood at
chi2 = 284,000 after 200 steps, where damping the steps that raise chi2 came to rest at 169,000. So the default is
Levenberg-Marquardt that starts undamped. The damping scales the diagonal of H (Marquardt's choice), which weighs metres
against radians as the measurements do.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.checks import check_numbers, check_weights
from mapmend.graph.pose_graph import Float, PoseGraph
from mapmend.graph.system import Factorization, Linearization, System
from mapmend.parallel import Progress, no_progress

METHODS = ("levenberg-marquardt", "gauss-newton")
LEAST_DAMPING, MOST_DAMPING, DAMPING_FACTOR = 1e-5, 1e8, 10.0


@dataclass(frozen=True)
class OptimizerSettings:
    """``method``: "levenberg-marquardt" takes the Gauss-Newton step wherever it lowers chi2, and damps where it does
    not; "gauss-newton" takes every step, whatever chi2 does.

    ``tolerance_sigma``: done when a step is shorter than this many standard deviations of the whole solution,
    ``sqrt(d^T H d)``, which asks nothing of units; or than ``tolerance_share`` of chi2 could gain, where chi2 is so
    large that rounding hides the rest.
    """

    method: str = METHODS[0]
    max_iterations: int = 100
    tolerance_sigma: float = 1e-3
    tolerance_share: float = 1e-9

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise MapmendError(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")
        if self.max_iterations < 0:
            raise MapmendError(f"max_iterations must not be negative, got {self.max_iterations}")
        if not (self.tolerance_sigma >= 0.0 and self.tolerance_share >= 0.0):
            raise MapmendError("tolerance_sigma and tolerance_share must not be negative")


DEFAULT_SETTINGS = OptimizerSettings()


@dataclass(frozen=True)
class OptimizationResult:
    """``poses``: shape (n, 3), ``T_map_robot``, angles of the moved nodes in [-pi, pi).

    ``iterations`` counts the steps that were tried. ``seconds``: "analyse" for checks and pattern, "solve" from the
    first linearization to the last update, ordering included. ``system`` serves the same edges again.
    """

    poses: Float
    chi2_initial: float
    chi2_final: float
    iterations: int
    converged: bool
    seconds: dict[str, float]
    system: System
    linearization: Linearization

    @cached_property
    def factorization(self) -> Factorization:
        """The factor of H at ``poses``, made when it is first asked for: what ``marginals`` takes.

        Raises ``MapmendError`` where H is singular to rounding.
        """
        return self.system.factorize(self.linearization.values)


def optimize(
    graph: PoseGraph,
    settings: OptimizerSettings = DEFAULT_SETTINGS,
    progress: Progress = no_progress,
    *,
    weights: Float | None = None,
    system: System | None = None,
) -> OptimizationResult:
    """The optimum nearest ``graph.poses``; the fixed nodes stay.

    ``weights``: shape (m,), factors on the edges' information. ``system``: that of an earlier result over the same
    edges and fixed nodes, which saves ordering and analysis. Raises ``MapmendError`` for numbers that are not finite,
    information that is not positive definite, and nodes that no edges tie to a fixed one.
    """
    began = time.perf_counter()
    check_numbers(graph)
    information = graph.information
    if weights is not None:
        check_weights(graph, weights)
        information = information * weights[:, None, None]
    if system is None:
        system = System(graph)
    elif not system.matches(graph):
        raise MapmendError("the system given was made for other edges or other fixed nodes")
    analysed = time.perf_counter()
    descent = _Descent(system, graph, information)
    chi2_initial = descent.here.chi2
    if not np.isfinite(chi2_initial):
        raise MapmendError("chi2 at the given poses is not finite: some numbers are too large to square")
    iterations, converged = _descend(descent, settings, progress)
    seconds = {"analyse": analysed - began, "solve": time.perf_counter() - analysed}
    return OptimizationResult(
        descent.poses, chi2_initial, descent.here.chi2, iterations, converged, seconds, system, descent.here
    )


def _descend(descent: _Descent, settings: OptimizerSettings, progress: Progress) -> tuple[int, bool]:
    """Steps until one is too short to matter; how many, and whether it came to that."""
    if not descent.system.size:
        return 0, True
    damping = 0.0
    for iteration in range(settings.max_iterations):
        step, gain = descent.propose(damping)
        enough = max(settings.tolerance_sigma**2, settings.tolerance_share * descent.here.chi2)
        converged = damping < 1.0 and gain <= enough
        if descent.take(step, whatever=settings.method == "gauss-newton"):
            damping = damping / DAMPING_FACTOR if damping > LEAST_DAMPING else 0.0
        else:
            damping = max(LEAST_DAMPING, damping * DAMPING_FACTOR)
        progress("optimize", iteration + 1, settings.max_iterations)
        if converged:
            return iteration + 1, True
        if damping > MOST_DAMPING:
            return iteration + 1, False
    return settings.max_iterations, False


class _Descent:
    """Where the optimizer stands."""

    def __init__(self, system: System, graph: PoseGraph, information: Float) -> None:
        self.system = system
        self.measurements = graph.measurements
        self.information = information
        self.poses = graph.poses.copy()
        self.here = system.linearize(self.poses, self.measurements, information)

    def propose(self, damping: float) -> tuple[Float, float]:
        """The damped step, shape (size,), and how far it goes downhill: ``d^T H d``, if undamped."""
        step = self.system.solve(self.here.values, -self.here.gradient, damping)
        # Not by "@": the BLAS spreads 10,000 products over threads, which cost more than the whole step.
        return step, -float((step * self.here.gradient).sum())

    def take(self, step: Float, whatever: bool) -> bool:
        """Moves by the step if chi2 doesn't rise by it, or ``whatever`` it does; says whether it moved."""
        poses = self.system.move(self.poses, step)
        there = self.system.linearize(poses, self.measurements, self.information)
        if not (there.chi2 <= self.here.chi2 or (whatever and np.isfinite(there.chi2))):
            return False
        self.poses, self.here = poses, there
        return True


def edge_errors(graph: PoseGraph) -> Float:
    """``measurement^-1 * (X_i^-1 * X_j)`` as (x, y, wrapped angle) of every edge, shape (m, 3), metres and radians."""
    seen = se2.between(graph.poses[graph.edges[:, 0]], graph.poses[graph.edges[:, 1]])
    return se2.between(graph.measurements, seen)


def edge_chi2(graph: PoseGraph) -> Float:
    """``e^T Omega e`` of every edge, shape (m,)."""
    errors = edge_errors(graph)
    return np.asarray(np.einsum("mi,mij,mj->m", errors, graph.information, errors))
