"""The cascaded test: pairs of scans, scans (MC sections IV-A and IV-B), and in addition the whole map.

Tests of pairs that share a scan are not independent: if the pose of a scan is slightly wrong, many of its pairs fail
together, and if a place was matched badly, many scans fail together. The binomial distribution of MC (7) becomes a
beta-binomial one, whose ``dependence`` is the correlation between two of the tests; without dependence it is the
binomial.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import ConsistencyConfig
from mapmend.consistency.measure import PairMeasures
from mapmend.consistency.scale import (
    HALF_NORMAL_MEAN,
    HALF_NORMAL_STD,
    OdometryMap,
    implied_scale,
    pair_scales,
)

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

BULK, TAIL = 0.9, 1.9
"""In a consistent map, the value that one in a hundred of all pairs exceeds is this many times the value that a tenth
of the pairs of one pass (`consistency.same_pass_m`) exceed. A wrong loop cannot move the scans of such pairs far apart,
so a wrong map does not widen its own scales."""

FEWEST_PAIRS = 100
"""With fewer such pairs, their distribution is not estimated."""


@dataclass(frozen=True)
class PairTests:
    """The tested pairs, a row each: ``pairs`` (k, 2), ``psi`` (k,) as in MC (5), ``failed`` (k,) by MC (6).

    ``inflation``: the factor on all scales by which the pairs of one pass narrowed or widened them.
    """

    pairs: Int
    psi: Float
    failed: Bool
    inflation: float


@dataclass(frozen=True)
class ScanTests:
    """``tested``, ``failures``: (n,), each scan's pairs. ``p_values``: (n,). ``failed``: (n,), MC (7)."""

    tested: Int
    failures: Int
    p_values: Float
    failed: Bool

    @property
    def count(self) -> int:
        """How many scans were tested: those with at least one pair."""
        return int(np.count_nonzero(self.tested))


def judge_pairs(
    measures: PairMeasures, scales: Float, config: ConsistencyConfig, laid: OdometryMap | None = None
) -> PairTests:
    """MC (5) and (6) for all pairs that keep enough points; ``scales``: (n,), metres.

    ``laid`` determines which pairs belong to one pass; without it the scales stay as they are.
    """
    from scipy.stats import norm

    enough = measures.kept >= config.min_points
    pairs, n, total = measures.pairs[enough], measures.kept[enough], measures.kept_m[enough]
    scale = pair_scales(scales, pairs, config)
    same_pass = laid.within(pairs, config.same_pass_m) if laid else np.zeros(len(pairs), np.bool_)
    needed = implied_scale(total[same_pass], n[same_pass], config.pair_level) / scale[same_pass]
    inflation = _inflation(needed, config)
    psi = standardized(total, n.astype(np.float64), inflation * scale)
    return PairTests(pairs, psi, psi > norm.isf(config.pair_level), inflation)


def standardized(measure_m: Float, points: Float, scales: Float) -> Float:
    """MC (5): how many standard deviations M_ij is above the expected sum of n_ij half-normal depths, (k,)."""
    return np.asarray((measure_m / scales - points * HALF_NORMAL_MEAN) / (np.sqrt(points) * HALF_NORMAL_STD))


def _inflation(needed: Float, config: ConsistencyConfig) -> float:
    """The factor on the scales that the pairs of one pass need, (k,), within its limits."""
    wanted = TAIL * float(np.quantile(needed, BULK)) if len(needed) >= FEWEST_PAIRS else 1.0
    return float(np.clip(wanted, config.least_inflation, config.most_inflation))


def judge_scans(tests: PairTests, n: int, config: ConsistencyConfig) -> ScanTests:
    """MC (7) for each of n scans: whether it has more failed pairs than chance explains at ``config.scan_level``."""
    tested = np.bincount(tests.pairs.ravel(), minlength=n)
    failures = np.bincount(tests.pairs[tests.failed].ravel(), minlength=n)
    p_values = np.ones(n)
    some = failures > 0
    # Many scans have the same counts, so each combination is computed once.
    counts, back = np.unique(np.stack((failures[some], tested[some]), axis=1), axis=0, return_inverse=True)
    p_values[some] = survival(counts[:, 0], counts[:, 1], config.pair_level, config.scan_dependence)[back.ravel()]
    return ScanTests(tested, failures, p_values, p_values <= config.scan_level)


def map_p_value(scans: ScanTests, config: ConsistencyConfig) -> float:
    """The probability that a consistent map of as many tested scans has as many failed ones or more."""
    tested = scans.count
    failed = np.count_nonzero(scans.failed)
    counts = (np.array([failed]), np.array([tested]))
    return float(survival(*counts, config.scan_level, config.map_dependence)[0])


def survival(at_least: Int, of: Int, level: float, dependence: float) -> Float:
    """The probability of ``at_least`` failures or more in ``of`` tests at ``level``, elementwise, (k,).

    Beta-binomial with the mean ``level`` and the correlation ``dependence`` between tests; binomial where that is 0.
    """
    from scipy.stats import betabinom, binom

    if dependence == 0.0:
        return np.asarray(binom.sf(at_least - 1, of, level))
    rest = (1.0 - dependence) / dependence
    p_values = np.ones(len(at_least))
    some = at_least > 0
    p_values[some] = betabinom.sf(at_least[some] - 1, of[some], level * rest, (1.0 - level) * rest)
    return np.clip(p_values, 0.0, 1.0)
