"""Graduated non-convexity: truncated least squares, reached by degrees (GNC-TLS; Yang et al., RA-L 2020).

The surrogate of ``TruncatedQuadratic`` is all but convex for a small mu and the truncated quadratic for a large one.
Each degree goes a few steps down its surrogate from where the one before ended, while its bounds close in on phi.

Yang et al. begin with all edges at full weight and a mu at which none is left out, and solve each degree from the start
anew; for rotations and registrations there is a global solver for that. Poses from odometry are another case: they are
about right nearby and far off after a long way. There, false loops that count in full fold the map up at once, and what
is folded stays folded: M3500 with 100 random false loops ended 18 m off. So this begins at ``FIRST_MU``, where a loop
counts nothing as long as its error is ten times what phi allows. Loops that odometry all but confirms pull first; what
they straighten brings the others within reach before the bounds have closed.
"""

from __future__ import annotations

from dataclasses import replace

from mapmend.graph.descent import OptimizerSettings, descend
from mapmend.graph.robust import GraduatedNonConvexity, TruncatedQuadratic
from mapmend.graph.robust_descent import KernelDescent
from mapmend.parallel import Progress

FIRST_MU = 0.01
"""The first degree leaves out what is beyond ``phi (mu + 1) / mu``, about a hundred times phi."""

MU_FACTOR = 1.4
"""From one degree to the next: that of Yang et al."""

STEPS_A_DEGREE = 2
DEGREE_SIGMA = 0.1
"""A degree ends with a step of less than this many standard deviations: the next one moves on anyway."""

LARGEST_MU = 1e3
"""From here on the surrogate blends over a thousandth of phi."""


def graduate(
    descent: KernelDescent, kernel: GraduatedNonConvexity, settings: OptimizerSettings, progress: Progress
) -> tuple[int, bool]:
    """Descends by all degrees, and then to the truncated cost; how many steps, and whether it converged."""
    degree = replace(settings, max_iterations=STEPS_A_DEGREE, tolerance_sigma=DEGREE_SIGMA)
    iterations, mu = 0, FIRST_MU
    while mu < LARGEST_MU:
        surrogate = TruncatedQuadratic(kernel.phi, mu)
        descent.use(surrogate)
        iterations += descend(descent, degree, progress)[0]
        if surrogate.is_decided(descent.edge_chi2[descent.doubted]):
            break
        mu *= MU_FACTOR
    descent.use(kernel)
    steps, converged = descend(descent, settings, progress)
    return iterations + steps, converged
