"""Robust kernels: the cost of an edge that may be false. This file has all formulas and their sources.

With ``c = e^T Omega e`` an edge costs ``rho(c)`` instead of c, and enters the normal equations with its information
times ``w(c) = d rho / d c``: iteratively reweighted least squares, whose gradient is that of the sum of the costs. So
a step is accepted or refused by the same cost that it descends. All costs rise from 0 as c does; ``phi``, in units of
chi2, is the value from which on a kernel reduces the weight.

=================  =============================================  ==============================  ====================
kernel             cost rho(c)                                    weight w(c)                     source
=================  =============================================  ==============================  ====================
``huber``          c; beyond phi ``2 sqrt(phi c) - phi``          1; ``sqrt(phi / c)``            Huber 1964
``cauchy``         ``phi log(1 + c / phi)``                       ``phi / (phi + c)``             Black and Rangarajan
                                                                                                  1996 (Lorentzian)
``geman-mcclure``  ``phi c / (phi + c)``                          ``(phi / (phi + c))^2``         Geman and McClure 1985
``dcs``            c; beyond phi ``3 phi - 4 phi^2 / (phi + c)``  ``s^2``,                        Agarwal et al.,
                                                                  ``s = 2 phi / (phi + c) <= 1``  ICRA 2013
``switchable``     least over s of ``s^2 c + phi (1 - s)^2``      ``s^2``                         Suenderhauf and
                                                                                                  Protzel, IROS 2012
``max-mixture``    the less of c and ``q c + (1 - q) phi``        1; beyond phi ``q``             Olson and Agarwal,
                                                                                                  RSS 2012
``gnc``            the less of c and phi, approached through      1; beyond phi 0                 Yang et al., RA-L
                   ``gnc.graduate``                                                               2020 (GNC-TLS)
=================  =============================================  ==============================  ====================

*DCS and switches.* DCS gives the scale s only. The cost above is the one whose derivative by c is s^2. It is also the
minimum over s in [0, 1] of ``s^2 c + phi (1 - s)(3 - s)``: a switch drawn towards 2 that stops at 1, while that of
``switchable`` is drawn towards 1. Minimized over s, ``switchable`` has the optima of ``geman-mcclure``; but its
switches are variables that start at 1 and move with the poses (``robust_descent.SwitchDescent``), so the path differs.

*Max-mixture.* The null hypothesis is a second Gaussian with the same mean, its information scaled by
q = ``null_scale`` and its weight ``null_weight`` beside the first one's 1. The more likely component counts, that is
the smaller of c and ``q c - 2 log(null_weight) - 3 log(q)``. phi is where they meet; it is equivalent to
``null_weight``.

*Defaults.* phi is the 99 % quantile of a true edge's c, except for ``cauchy``, whose tail needs a smaller value: with
that phi, Bicocca 25b without a threshold ends 8.9 m off, with 1 it ends 1.1 m off. DCS is published with phi = 1; from
odometry that leaves out true loops that are far off because of drift (ringCity 3.3 m instead of 0.9 m, Bicocca 25b with
few false loops 3.3 m instead of 1.0 m: ``benchmarks/robustness.py``).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import Float, Int

DISTRUST_WEIGHT = 0.25
"""An edge is distrusted if its weight is below this, that is, if its switch is below one half."""

TRUE_EDGE_CHI2 = 11.345
"""The 99 % quantile of chi-square with three degrees of freedom: one true edge in a hundred has a larger c."""


@dataclass(frozen=True)
class Kernel(ABC):
    """``phi`` is in units of chi2; raises ``MapmendError`` if it is not a number above 0."""

    phi: float = TRUE_EDGE_CHI2

    def __post_init__(self) -> None:
        if not (self.phi > 0.0 and math.isfinite(self.phi)):
            raise MapmendError(f"phi must be a number above 0, got {self.phi}")

    @abstractmethod
    def cost(self, chi2: Float) -> Float:
        """``rho(c)`` of every c, any shape."""

    @abstractmethod
    def weight(self, chi2: Float) -> Float:
        """``d rho / d c``, the factor on the information, of every c."""


@dataclass(frozen=True)
class Huber(Kernel):
    """Quadratic up to phi, linear in the error beyond: convex in e, so outliers lose influence but keep some."""

    def cost(self, chi2: Float) -> Float:
        return np.where(chi2 <= self.phi, chi2, 2.0 * np.sqrt(self.phi * chi2) - self.phi)

    def weight(self, chi2: Float) -> Float:
        return np.asarray(np.sqrt(self.phi / np.maximum(chi2, self.phi)))


@dataclass(frozen=True)
class Cauchy(Kernel):
    """Grows with the logarithm of c: an outlier's influence falls, but never to zero."""

    phi: float = 1.0

    def cost(self, chi2: Float) -> Float:
        return np.asarray(self.phi * np.log1p(chi2 / self.phi))

    def weight(self, chi2: Float) -> Float:
        return np.asarray(self.phi / (self.phi + chi2))


@dataclass(frozen=True)
class GemanMcClure(Kernel):
    """Bounded by phi: an outlier's influence vanishes."""

    def cost(self, chi2: Float) -> Float:
        return np.asarray(self.phi * chi2 / (self.phi + chi2))

    def weight(self, chi2: Float) -> Float:
        return np.asarray((self.phi / (self.phi + chi2)) ** 2)


@dataclass(frozen=True)
class DynamicCovarianceScaling(Kernel):
    """Bounded by 3 phi, and the plain quadratic up to phi: good loops keep their full weight."""

    def cost(self, chi2: Float) -> Float:
        return np.where(chi2 <= self.phi, chi2, 3.0 * self.phi - 4.0 * self.phi**2 / (self.phi + chi2))

    def weight(self, chi2: Float) -> Float:
        return np.asarray(np.minimum(1.0, 2.0 * self.phi / (self.phi + chi2)) ** 2)


@dataclass(frozen=True)
class Switchable(Kernel):
    """One switch s for each edge, a variable beside the poses; the cost is ``s^2 c + phi (1 - s)^2``.

    ``cost`` and ``weight`` are those at the best switches; the optimizer moves the switches themselves.
    """

    def cost(self, chi2: Float) -> Float:
        return self.cost_at(self.best_switches(chi2), chi2)

    def weight(self, chi2: Float) -> Float:
        return np.asarray(self.best_switches(chi2) ** 2)

    def cost_at(self, switches: Float, chi2: Float) -> Float:
        """The cost with the switches where they are."""
        return np.asarray(switches**2 * chi2 + self.phi * (1.0 - switches) ** 2)

    def best_switches(self, chi2: Float) -> Float:
        """The switches of least cost."""
        return np.asarray(self.phi / (self.phi + chi2))


@dataclass(frozen=True)
class MaxMixture(Kernel):
    """The likelier of "true" and "false"; ``null_scale``, in (0, 1), scales the information of what is false.

    The smaller it is, the less false loops pull, and the fewer true loops close that are far off because of drift.
    """

    null_scale: float = 1e-6

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.null_scale < 1.0:
            raise MapmendError(f"null_scale must lie between 0 and 1, got {self.null_scale}")

    @property
    def null_weight(self) -> float:
        """The weight of the null hypothesis in the mixture, where that of the measurement is 1."""
        return math.exp(-0.5 * self.phi * (1.0 - self.null_scale)) * self.null_scale**-1.5

    def cost(self, chi2: Float) -> Float:
        return np.minimum(chi2, self.null_scale * chi2 + (1.0 - self.null_scale) * self.phi)

    def weight(self, chi2: Float) -> Float:
        return np.where(chi2 <= self.phi, 1.0, self.null_scale)


@dataclass(frozen=True)
class TruncatedQuadratic(Kernel):
    """The surrogate of GNC-TLS (Yang et al. 2020): almost convex for mu near 0, the quadratic cut at phi for mu = inf.

    Up to ``phi mu / (mu + 1)`` an edge counts in full, from ``phi (mu + 1) / mu`` on not at all, and between them it
    costs ``2 sqrt(phi c mu (mu + 1)) - mu (phi + c)``.
    """

    mu: float = math.inf

    def cost(self, chi2: Float) -> Float:
        if math.isinf(self.mu):
            return np.minimum(chi2, self.phi)
        lower, upper = self._bounds()
        between = np.clip(chi2, lower, upper)
        blend = 2.0 * np.sqrt(self.phi * between * self.mu * (self.mu + 1.0)) - self.mu * (self.phi + between)
        return np.where(chi2 < lower, chi2, blend)

    def weight(self, chi2: Float) -> Float:
        if math.isinf(self.mu):
            return np.where(chi2 <= self.phi, 1.0, 0.0)
        lower, upper = self._bounds()
        blend = np.sqrt(self.phi * self.mu * (self.mu + 1.0) / np.clip(chi2, lower, upper)) - self.mu
        return np.where(chi2 <= lower, 1.0, np.where(chi2 >= upper, 0.0, blend))

    def is_decided(self, chi2: Float) -> bool:
        """Whether every edge counts in full or not at all."""
        lower, upper = self._bounds()
        return bool(np.all((chi2 <= lower) | (chi2 >= upper)))

    def _bounds(self) -> tuple[float, float]:
        return self.phi * self.mu / (self.mu + 1.0), self.phi * (self.mu + 1.0) / self.mu


@dataclass(frozen=True)
class GraduatedNonConvexity(TruncatedQuadratic):
    """Truncated least squares, reached from plain least squares by degrees (``gnc.graduate``)."""


KERNELS: dict[str, type[Kernel]] = {
    "huber": Huber,
    "cauchy": Cauchy,
    "geman-mcclure": GemanMcClure,
    "dcs": DynamicCovarianceScaling,
    "switchable": Switchable,
    "max-mixture": MaxMixture,
    "gnc": GraduatedNonConvexity,
}


def kernel_of(name: str, phi: float | None = None) -> Kernel | None:
    """The kernel with this name, with its default phi or the given one; None for "none".

    Raises ``MapmendError`` for a name that is not in ``KERNELS``, and for a phi that is not valid.
    """
    if name == "none":
        return None
    if name not in KERNELS:
        raise MapmendError(f"kernel must be none or one of {', '.join(KERNELS)}, got {name!r}")
    return KERNELS[name]() if phi is None else KERNELS[name](phi)


def distrusted(edge_weights: Float) -> Int:
    """The rows of the edges whose weight, of shape (m,), is below ``DISTRUST_WEIGHT``."""
    return np.flatnonzero(edge_weights < DISTRUST_WEIGHT)
