"""Graduated non-convexity: truncated least squares, reached by degrees (GNC-TLS; Yang et al., RA-L 2020).

Yang et al. begin with the optimum of plain least squares, which a global solver gives for rotations and registrations,
and reject edges by degrees of ``TruncatedQuadratic``. A map from odometry is a different case: it is about right over
short distances and far off over long ones, and false loops with full weight fold it up. A folded map stays folded: on
M3500 with 100 random false loops, their method ended 18 m off, unless each degree began at the odometry again; on
ringCity with 1,000 false loops in groups it failed even then (28 m). So the degrees here begin from the other side.

*Widening.* DCS begins with a phi far below the requested one, which then grows. Loops that almost agree with the
odometry pull first; they straighten the map, which brings others within reach. The weights of DCS fall with distance
but never vanish, so that true loops that are far off because of drift can still close. If DCS begins with the whole phi
and there are many false loops, they win as often as true ones (M3500 with 1,000 false loops in groups: 23 m off).

*Closing.* DCS alone does not decide: false loops nearby keep pulling a little, and true ones beyond phi count less. By
degrees of ``TruncatedQuadratic``, each edge ends with full weight or with none.

*Two passes, and the cost decides.* Where random false loops outnumber the true ones, one pass is not enough: on
ringCity, with 1,000 of them beside 901, it ended 21 m off. So there are two passes. The first uses all doubted edges.
The second uses only edges that another one confirms (``agreement``), which excludes random false loops. When these are
closed, the others are added by DCS with the whole phi, and all are closed. The result is the pass with the lower
truncated cost, which is what ``gnc`` minimizes. Each pass fails in cases where the other does not: the second misses
true loops without neighbours.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mapmend.graph.agreement import confirmed_loops
from mapmend.graph.descent import OptimizerSettings, descend
from mapmend.graph.robust import DynamicCovarianceScaling, GraduatedNonConvexity, Kernel, TruncatedQuadratic
from mapmend.graph.robust_descent import KernelDescent
from mapmend.parallel import Progress, no_progress

WIDENING = (1.0 / 32.0, 1.0 / 10.0, 1.0 / 3.2, 1.0)
"""The shares of phi that DCS goes through, half a decade a step. The first allows a sixth of the error of phi."""

FIRST_MU = 0.1
"""The closing begins where an edge is left out beyond ``phi (mu + 1) / mu``: three times the error that phi allows."""

MU_FACTOR = 1.4
"""The factor from one degree to the next, as in Yang et al."""

LARGEST_MU = 1e3
"""The last degree: there the surrogate blends over a thousandth of phi."""

DEGREES = math.ceil(math.log(LARGEST_MU / FIRST_MU) / math.log(MU_FACTOR))

STEPS_A_DEGREE = 2
DEGREE_SIGMA = 0.1
"""A degree ends with a step of less than this many standard deviations; more is not needed before the next degree."""


def graduate(
    descent: KernelDescent, kernel: GraduatedNonConvexity, settings: OptimizerSettings, progress: Progress
) -> tuple[int, bool]:
    """Minimizes the truncated cost in both passes; returns the number of steps and whether the better pass
    converged."""
    confirmed = confirmed_loops(descent.graph, descent.information, descent.doubted)
    ways = _Ways(kernel, settings, progress, both=bool(confirmed.any() and (descent.doubted & ~confirmed).any()))
    part = descent.part(~descent.doubted | confirmed) if ways.both else None
    ways.widen(descent)
    converged = ways.close(descent)
    if part is not None:
        poses, cost = descent.poses, descent.cost
        ways.widen(part)
        ways.close(part)
        descent.restart(part.poses)
        ways.settle(descent, DynamicCovarianceScaling(kernel.phi))
        converged_there = ways.close(descent)
        if descent.cost < cost:
            converged = converged_there
        else:
            descent.restart(poses)
    return ways.iterations, converged


class _Ways:
    """The stages of the passes; counts the steps and reports progress."""

    def __init__(
        self, kernel: GraduatedNonConvexity, settings: OptimizerSettings, progress: Progress, both: bool
    ) -> None:
        self.kernel, self.settings, self.progress, self.both = kernel, settings, progress, both
        self.rough = replace(settings, tolerance_sigma=DEGREE_SIGMA)
        self.brief = replace(self.rough, max_iterations=min(STEPS_A_DEGREE, settings.max_iterations))
        once = len(WIDENING) + DEGREES + 1
        self.total = 2 * once + 1 + DEGREES + 1 if both else once
        self.iterations = self.stage = 0

    def widen(self, descent: KernelDescent) -> None:
        """DCS with growing shares of phi."""
        for share in WIDENING:
            self.settle(descent, DynamicCovarianceScaling(share * self.kernel.phi))

    def settle(self, descent: KernelDescent, kernel: Kernel) -> None:
        """Descends roughly to the optimum under one kernel."""
        descent.use(kernel)
        self._descend(descent, self.rough, 1)

    def close(self, descent: KernelDescent) -> bool:
        """Goes by degrees to the truncated cost and descends to its optimum; returns whether it converged."""
        end = self.stage + DEGREES
        for degree in range(DEGREES):
            surrogate = TruncatedQuadratic(self.kernel.phi, FIRST_MU * MU_FACTOR**degree)
            descent.use(surrogate)
            self._descend(descent, self.brief, 1)
            if surrogate.is_decided(descent.edge_chi2[descent.doubted]):
                break
        descent.use(self.kernel)
        return self._descend(descent, self.settings, end + 1 - self.stage)

    def _descend(self, descent: KernelDescent, settings: OptimizerSettings, stages: int) -> bool:
        steps, converged = descend(descent, settings, no_progress)
        self.iterations += steps
        self.stage += stages
        self.progress("optimize", self.stage, self.total)
        return converged
