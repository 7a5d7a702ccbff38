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
"""

from __future__ import annotations

import math
from dataclasses import replace

from mapmend.graph.descent import OptimizerSettings, descend
from mapmend.graph.robust import DynamicCovarianceScaling, GraduatedNonConvexity, TruncatedQuadratic
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
    """Widens, closes and descends to the truncated cost; how many steps, and whether it converged."""
    rough = replace(settings, tolerance_sigma=DEGREE_SIGMA)
    brief = replace(rough, max_iterations=min(STEPS_A_DEGREE, settings.max_iterations))
    total = len(WIDENING) + DEGREES + 1
    iterations = 0
    for stage, share in enumerate(WIDENING):
        descent.use(DynamicCovarianceScaling(share * kernel.phi))
        iterations += descend(descent, rough, no_progress)[0]
        progress("optimize", stage + 1, total)
    for degree in range(DEGREES):
        surrogate = TruncatedQuadratic(kernel.phi, FIRST_MU * MU_FACTOR**degree)
        descent.use(surrogate)
        iterations += descend(descent, brief, no_progress)[0]
        progress("optimize", len(WIDENING) + degree + 1, total)
        if surrogate.is_decided(descent.edge_chi2[descent.doubted]):
            break
    descent.use(kernel)
    steps, converged = descend(descent, settings, no_progress)
    progress("optimize", total, total)
    return iterations + steps, converged
