"""The state of the optimizer and its steps: Gauss-Newton steps, damped where they do not lower the cost."""

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
"""A chain of n nodes resists bending along its whole length with 1 / n^2 of the diagonal of H. More damping than that
keeps the map in its initial shape, so that true loops look false: M3500 from odometry, with 100 false loops and the
kernel ``dcs``, ended 13.5 m off with a value of 1e-5, and 0.2 mm off with 1e-9."""

FAR_DAMPING = 1e-4
"""If the very first step raises chi2, the start is far from any optimum, and shorter steps find a lower one: Bicocca
25b without a threshold ends at 159,253 from odometry instead of 177,937. Not used with a kernel, for the reason
above."""

CHEAP_SHARE = 0.1
"""A step with an old factor is taken if its gain is at most this share of the previous gain. Then it has a third of the
previous length, and a few cheap steps reduce the length as much as one expensive step."""

FORESEEN_SHARE = 1e-3
"""A predicted step is not taken if its gain is below this share of the tolerance."""

SLOW_SHARE, LEAST_SHARE, WHOLE_SHARE = 0.25, 0.5, 0.9
"""If a step gains more than a quarter of the previous gain, the next step may be shortened: by a half at most, and not
by less than a tenth. So Bicocca 25b without a threshold converges in 70 steps from the chordal start; with whole steps
it had not converged after 1,000."""


@dataclass(frozen=True)
class OptimizerSettings:
    """``method``: "levenberg-marquardt" takes the Gauss-Newton step wherever it lowers chi2, and damps where it does
    not; "gauss-newton" takes every step, whatever chi2 does.

    ``tolerance_sigma``: the descent ends when a step is shorter than this many standard deviations of the whole
    solution, ``sqrt(d^T H d)``, which does not depend on units, or when the next step, predicted from how the steps
    have shrunk, would be far shorter. It also ends when a step gains less than ``tolerance_share`` of chi2: chi2 is
    then so large that rounding hides the rest.
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
    """Plain least squares: every edge costs its chi2. The steps lower ``cost``; ``chi2`` is that of all edges."""

    cost: float
    chi2: float
    here: Linearization
    first_damping = FAR_DAMPING

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
        return self._downhill(self.system.solve(self.here.values, -self.here.gradient, damping))

    def propose_cheaply(self) -> tuple[Float, float]:
        """The step with the factor of the last ``propose``; it takes a fourth of the time of a step with a new
        factor."""
        return self._downhill(self.system.solve_again(-self.here.gradient))

    def take(self, step: Float, whatever: bool) -> bool:
        """Takes the step if it does not raise the cost, or always if ``whatever``; returns whether it was taken."""
        poses = self.system.move(self.poses, step)
        there = self.system.linearize(poses, self.measurements, self.information, self._spare)
        if not self._is_better(there.chi2, whatever):
            self._spare = there
            return False
        self.poses, self.here, self._spare = poses, there, self.here
        self.cost = self.chi2 = there.chi2
        return True

    def weights(self) -> Float:
        """The kernel's factor on the information of every edge, shape (m,): here 1."""
        return np.ones(len(self.measurements))

    def _downhill(self, step: Float) -> tuple[Float, float]:
        # Not by "@": the BLAS spreads 10,000 products over threads, which cost more than the whole step.
        return step, -float((step * self.here.gradient).sum())

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
    """Takes steps until the next one would be negligible; returns their number and whether it converged.

    Near the optimum H hardly changes from step to step. The factor of an earlier step is used again (a chord method:
    Ortega and Rheinboldt 1970) as long as each step gains a tenth of the previous one, or less. Such steps also predict
    the gain of the next one, which is not taken if its gain is far too small.
    """
    if not descent.system.size:
        return 0, True
    whatever = settings.method == "gauss-newton"
    damping, share, last_gain, has_factor = 0.0, 1.0, np.inf, False
    for iteration in range(settings.max_iterations):
        enough = max(settings.tolerance_sigma**2, settings.tolerance_share * descent.cost)
        is_cheap = has_factor and not whatever
        if is_cheap:
            step, gain = descent.propose_cheaply()
            is_cheap = 0.0 <= gain <= CHEAP_SHARE * last_gain
        if not is_cheap:
            step, gain = descent.propose(damping)
        converged = damping < 1.0 and gain <= enough
        converged |= is_cheap and gain * gain <= FORESEEN_SHARE * enough * last_gain
        moved = descent.take(share * step, whatever)
        undamped = moved and damping == 0.0
        if moved:
            damping = damping / DAMPING_FACTOR if damping > LEAST_DAMPING else 0.0
        elif not is_cheap:
            damping = max(descent.first_damping if iteration == 0 else LEAST_DAMPING, damping * DAMPING_FACTOR)
        is_slow = undamped and gain > SLOW_SHARE * last_gain and not whatever
        share = _share(share, gain, float((step * descent.here.gradient).sum())) if is_slow else 1.0
        has_factor, last_gain = undamped and share == 1.0, gain
        progress("optimize", iteration + 1, settings.max_iterations)
        if converged:
            return iteration + 1, True
        if damping > MOST_DAMPING:
            return iteration + 1, False
    return settings.max_iterations, False


def _share(share: float, gain: float, slope: float) -> float:
    """Which share of the next step to take: the share with which the last step would have ended at the lowest cost.

    ``gain``: the negative slope of the cost along the last step, of which ``share`` was taken, at its beginning;
    ``slope``: the slope at its end. Where residuals are large, Gauss-Newton oversteps again and again along the same
    line, each time by nearly as much; the secant through both slopes estimates where the slope is zero. If the result
    is nearly a whole step, the whole step is taken.
    """
    best = share * gain / (gain + slope) if gain + slope > 0.0 else 1.0
    return max(LEAST_SHARE, best) if best < WHOLE_SHARE else 1.0
