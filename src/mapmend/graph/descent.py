"""Where the optimizer stands, and how it goes on from there: Gauss-Newton steps, damped where they don't help."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import Float, PoseGraph
from mapmend.graph.system import KERNEL_ARRAYS, Linearization, System
from mapmend.parallel import Progress

METHODS = ("levenberg-marquardt", "gauss-newton")
MOST_DAMPING, DAMPING_FACTOR = 1e8, 10.0

LEAST_DAMPING = 1e-9
"""A chain of n nodes bends along its whole length against 1 / n^2 of the diagonal of H. More damping than that holds
the map in the shape it starts with, so that true loops look false: M3500 from odometry, with 100 false loops and the
kernel ``dcs``, ended 13.5 m off where this was 1e-5, 0.2 mm off with 1e-9."""


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


class Descent:
    """Plain least squares: every edge costs its chi2. ``cost`` is what the steps lower, ``chi2`` that of all edges."""

    cost: float
    chi2: float
    here: Linearization

    def __init__(self, system: System, graph: PoseGraph, information: Float) -> None:
        self.system = system
        self.graph = graph
        self.measurements = graph.measurements
        self.information = information
        self.poses = graph.poses.copy()
        self._spare: Linearization | None = None
        self._begin()

    def propose(self, damping: float) -> tuple[Float, float]:
        """The damped step, shape (size,), and how far it goes downhill: ``d^T H d``, if undamped."""
        step = self.system.solve(self.here.values, -self.here.gradient, damping)
        # Not by "@": the BLAS spreads 10,000 products over threads, which cost more than the whole step.
        return step, -float((step * self.here.gradient).sum())

    def take(self, step: Float, whatever: bool) -> bool:
        """Moves by the step if the cost doesn't rise by it, or ``whatever`` it does; says whether it moved."""
        poses = self.system.move(self.poses, step)
        there = self.system.linearize(poses, self.measurements, self.information, self._spare)
        if not self._is_better(there.chi2, whatever):
            self._spare = there
            return False
        self.poses, self.here, self._spare = poses, there, self.here
        self.cost = self.chi2 = there.chi2
        return True

    def weights(self) -> Float:
        """What the kernel makes of the information of every edge, shape (m,): here 1."""
        return np.ones(len(self.measurements))

    def _begin(self) -> None:
        self.here = self.system.linearize(self.poses, self.measurements, self.information)
        self.cost = self.chi2 = self.here.chi2

    def _is_better(self, cost: float, whatever: bool) -> bool:
        return cost <= self.cost or (whatever and bool(np.isfinite(cost)))

    def _errors(self, poses: Float) -> tuple[Float, Float]:
        """Errors (m, 3) and chi2 (m,) of all edges."""
        from mapmend.graph import _robust_kernels

        return _robust_kernels.edge_errors(
            np.require(poses, np.float64, KERNEL_ARRAYS),
            self.system.edges,
            np.require(self.measurements, np.float64, KERNEL_ARRAYS),
            np.require(self.information, np.float64, KERNEL_ARRAYS),
        )


def descend(descent: Descent, settings: OptimizerSettings, progress: Progress) -> tuple[int, bool]:
    """Steps until one is too short to matter; how many, and whether it came to that."""
    if not descent.system.size:
        return 0, True
    damping = 0.0
    for iteration in range(settings.max_iterations):
        step, gain = descent.propose(damping)
        enough = max(settings.tolerance_sigma**2, settings.tolerance_share * descent.cost)
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
