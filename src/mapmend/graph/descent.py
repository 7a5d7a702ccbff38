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

FAR_DAMPING = 1e-4
"""Where the very first step raises chi2, the start is far from any optimum, and a longer way round finds a lower one:
Bicocca 25b without a threshold ends at 159,253 from odometry, where it ended at 177,937. Not with a kernel, for the
reason above."""

CHEAP_SHARE = 0.1
"""A step by an old factor is taken where it gains at most this share of the step before: it has then a third of its
length, which a few cheap steps make as short as one dear one."""

FORESEEN_SHARE = 1e-3
"""Of the tolerance: what a step may gain that is foreseen and not taken."""

SLOW_SHARE, LEAST_SHARE, WHOLE_SHARE = 0.25, 0.5, 0.9
"""Where a step gains more than a quarter of the one before, the next may be shortened: by a half at most, and not by
less than a tenth. Bicocca 25b without a threshold, from the chordal start, converges in 70 steps so; whole steps
had not converged after 1,000."""


@dataclass(frozen=True)
class OptimizerSettings:
    """``method``: "levenberg-marquardt" takes the Gauss-Newton step wherever it lowers chi2, and damps where it does
    not; "gauss-newton" takes every step, whatever chi2 does.

    ``tolerance_sigma``: done when a step is shorter than this many standard deviations of the whole solution,
    ``sqrt(d^T H d)``, which asks nothing of units, or when the next one would be far shorter, as steps have shrunk so
    far; or where it gains less than ``tolerance_share`` of chi2, which is so large then that rounding hides the rest.
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
        """The step by the factor of the last ``propose``, which costs a fourth of one by a factor of its own."""
        return self._downhill(self.system.solve_again(-self.here.gradient))

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
    """Steps until none is left that matters; how many, and whether it came to that.

    Near the optimum H hardly changes from step to step, and the factor of an earlier one serves again (a chord method:
    Ortega and Rheinboldt 1970) as long as each step gains a tenth of the one before, or less. Then it is foreseen what
    the next one would gain, and where that is far too little the next is not taken.
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
    """Which share of the next step to take: that with which the last one would have ended where the cost was least.

    ``gain``: how steeply the last step, of which ``share`` was taken, went down where it began; ``slope``: how steeply
    it goes up where it ended. Where residuals are large, Gauss-Newton oversteps again and again along the same line,
    each time by nearly as much; the secant through both says where the middle is. A whole step where it is nearly one.
    """
    best = share * gain / (gain + slope) if gain + slope > 0.0 else 1.0
    return max(LEAST_SHARE, best) if best < WHOLE_SHARE else 1.0
