"""Graduated non-convexity: truncated least squares, reached by degrees (GNC-TLS; Yang et al., RA-L 2020).

Yang et al. begin with the optimum of plain least squares, which for rotations and registrations a global solver gives,
and let edges go by degrees of ``TruncatedQuadratic``. A map from odometry is another case: it is about right nearby and
far off after a long way, and false loops that count in full fold it up. What is folded stays folded: on M3500 with 100
random false loops their way ended 18 m off, unless each degree began at the odometry anew, and on ringCity with 1,000
false loops in groups also then (28 m). So the degrees here begin from the other side.

*Widening.* DCS with a phi far below the one asked for, then wider: loops that odometry all but confirms pull first, and
what they straighten brings others within reach. Its weights fade with distance but never vanish, so that true loops
which drift has parted find together. At once with the whole phi, false loops win as often as true ones where they are
many (M3500 with 1,000 false loops in groups: 23 m off).

*Closing.* What DCS lacks is the end: false loops nearby go on pulling a little, and true ones beyond phi count less. By
degrees of ``TruncatedQuadratic`` each edge comes to count in full or not at all.

*Two ways, and the cost decides.* Where random false loops outnumber the true ones, widening alone is lost: on ringCity
with 1,000 of them beside 901 it ended 21 m off. So it is gone twice: with all doubted edges, and with those only that
another one confirms (``agreement``), which random false loops do not, until these are closed; then the others come
back, by DCS with the whole phi, and all are closed. The end of less truncated cost, which is what is asked for,
is the result. Each way alone fails where the other does not: true loops that stand alone are missed by the second.
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
"""The shares of phi that DCS goes through: half a decade a step, from where an error is a sixth of what phi allows."""

FIRST_MU = 0.1
"""The closing begins where an edge is left out beyond ``phi (mu + 1) / mu``: three times the error that phi allows."""

MU_FACTOR = 1.4
"""From one degree to the next: that of Yang et al."""

LARGEST_MU = 1e3
"""From here on the surrogate blends over a thousandth of phi."""

DEGREES = math.ceil(math.log(LARGEST_MU / FIRST_MU) / math.log(MU_FACTOR))

STEPS_A_DEGREE = 2
DEGREE_SIGMA = 0.1
"""A degree ends with a step of less than this many standard deviations: the next one moves on anyway."""


def graduate(
    descent: KernelDescent, kernel: GraduatedNonConvexity, settings: OptimizerSettings, progress: Progress
) -> tuple[int, bool]:
    """Descends to the truncated cost both ways; how many steps, and whether the better one converged."""
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
    """The legs of the ways; counts the steps and tells the progress."""

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
        """DCS by shares of phi."""
        for share in WIDENING:
            self.settle(descent, DynamicCovarianceScaling(share * self.kernel.phi))

    def settle(self, descent: KernelDescent, kernel: Kernel) -> None:
        """About to the optimum under one kernel."""
        descent.use(kernel)
        self._descend(descent, self.rough, 1)

    def close(self, descent: KernelDescent) -> bool:
        """By degrees to the truncated cost, and to its optimum; whether it converged."""
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
