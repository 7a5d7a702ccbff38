"""The back end: the poses that agree best with all measurements, by Gauss-Newton and Levenberg-Marquardt.

Minimizes ``chi2 = sum e^T Omega e`` with ``e = measurement^-1 * (X_i^-1 * X_j)`` read as a vector (x, y, wrapped
angle): g2o's convention, so that chi2 compares with what is published for its graphs. GTSAM takes the logarithm of
the same pose, which differs in the second order of e, and reports half the sum.

Undamped steps converge in a few iterations if the graph is sound, and reach the published optima of intel and M3500
from odometry. With many false loops they wander: on Bicocca 25b without a threshold, Gauss-Newton was still at chi2 =
284,000 after 200 steps, while damping the steps that raise chi2 converged to 169,000. So the default is
Levenberg-Marquardt that starts undamped. The damping scales the diagonal of H (Marquardt's choice), which weighs metres
against radians as the measurements do.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.checks import check_numbers, check_weights
from mapmend.graph.descent import METHODS, Descent, OptimizerSettings, descend
from mapmend.graph.gnc import graduate
from mapmend.graph.pose_graph import Float, PoseGraph
from mapmend.graph.robust import GraduatedNonConvexity, Kernel, Switchable
from mapmend.graph.robust_descent import KernelDescent, SwitchDescent
from mapmend.graph.system import Factorization, Linearization, System
from mapmend.parallel import Progress, no_progress

__all__ = [
    "DEFAULT_SETTINGS",
    "METHODS",
    "OptimizationResult",
    "OptimizerSettings",
    "edge_chi2",
    "edge_errors",
    "optimize",
]

DEFAULT_SETTINGS = OptimizerSettings()


@dataclass(frozen=True)
class OptimizationResult:
    """``poses``: shape (n, 3), ``T_map_robot``, angles of the moved nodes in [-pi, pi).

    ``chi2_initial`` and ``chi2_final`` are those of all edges, at the given poses and at these, without the weights of
    a kernel; ``cost_initial`` and ``cost_final`` are those of the minimized cost, the same if there is no kernel.
    ``edge_weights``: shape (m,), the kernel's factors on the information, 1 where an edge has none
    (``robust.distrusted``). ``iterations`` counts the steps that were tried. ``seconds``: "analyse" for checks and
    pattern, "solve" from the first linearization to the last update, with the ordering. ``system`` can be used again
    for the same edges.
    """

    poses: Float
    chi2_initial: float
    chi2_final: float
    cost_initial: float
    cost_final: float
    edge_weights: Float
    iterations: int
    converged: bool
    seconds: dict[str, float]
    system: System
    linearization: Linearization

    @cached_property
    def factorization(self) -> Factorization:
        """The factor of H at ``poses``, made when it is first needed; ``marginals`` takes it.

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
    kernel: Kernel | None = None,
    doubted: NDArray[np.bool_] | None = None,
    threads: int = 1,
) -> OptimizationResult:
    """The optimum nearest to ``graph.poses``; the fixed nodes stay.

    ``weights``: shape (m,), factors on the edges' information. ``system``: that of an earlier result with the same
    edges and fixed nodes, which saves ordering and analysis. ``kernel``: the cost of the edges that may be false.
    ``doubted``: which edges these are, bool of shape (m,), by default the loop edges. Raises ``MapmendError`` for
    numbers that are not finite, information that is not positive definite, and nodes without a chain of edges to a
    fixed one.
    """
    began = time.perf_counter()
    check_numbers(graph)
    information = graph.information
    if weights is not None:
        check_weights(graph, weights)
        information = information * weights[:, None, None]
    doubted = graph.is_loop if doubted is None else doubted
    if doubted.shape != graph.is_loop.shape or doubted.dtype != np.bool_:
        raise MapmendError(f"doubted must be bool of shape {graph.is_loop.shape}, got {doubted.dtype} {doubted.shape}")
    if system is None:
        system = System(graph, threads)
    elif not system.matches(graph):
        raise MapmendError("the system given was made for other edges or other fixed nodes")
    analysed = time.perf_counter()
    descent = _descent(system, graph, information, kernel, doubted)
    chi2_initial, cost_initial = descent.chi2, descent.cost
    if not (np.isfinite(chi2_initial) and np.isfinite(cost_initial)):
        raise MapmendError("chi2 at the given poses is not finite: some numbers are too large to square")
    if isinstance(kernel, GraduatedNonConvexity) and isinstance(descent, KernelDescent):
        iterations, converged = graduate(descent, kernel, settings, progress)
    else:
        iterations, converged = descend(descent, settings, progress)
    seconds = {"analyse": analysed - began, "solve": time.perf_counter() - analysed}
    return OptimizationResult(
        descent.poses,
        chi2_initial,
        descent.chi2,
        cost_initial,
        descent.cost,
        descent.weights(),
        iterations,
        converged,
        seconds,
        system,
        descent.here,
    )


def _descent(
    system: System, graph: PoseGraph, information: Float, kernel: Kernel | None, doubted: NDArray[np.bool_]
) -> Descent:
    """The descent at its start: without kernel, with one, or with a kernel that has variables of its own."""
    if kernel is None or not doubted.any():
        return Descent(system, graph, information)
    if isinstance(kernel, Switchable):
        return SwitchDescent(system, graph, information, kernel, doubted)
    return KernelDescent(system, graph, information, kernel, doubted)


def edge_errors(graph: PoseGraph) -> Float:
    """``measurement^-1 * (X_i^-1 * X_j)`` as (x, y, wrapped angle) of every edge, shape (m, 3), metres and radians."""
    seen = se2.between(graph.poses[graph.edges[:, 0]], graph.poses[graph.edges[:, 1]])
    return se2.between(graph.measurements, seen)


def edge_chi2(graph: PoseGraph) -> Float:
    """``e^T Omega e`` of every edge, shape (m,)."""
    errors = edge_errors(graph)
    return np.asarray(np.einsum("mi,mij,mj->m", errors, graph.information, errors))
