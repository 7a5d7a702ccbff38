"""Whether covariances are right: the normalized estimation error squared (Bar-Shalom, Li and Kirubarajan, 2001)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array, between


def pose_errors(estimated: ArrayLike, true: ArrayLike) -> Array:
    """The errors ``d`` with ``T_true = T_estimated * d``, shape (n, 3), to which the project's covariances refer.

    Raises MapmendError unless both have shape (n, 3).
    """
    a, b = np.asarray(estimated, dtype=np.float64), np.asarray(true, dtype=np.float64)
    if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
        raise MapmendError(f"poses must have shape (n, 3) alike, got {a.shape} and {b.shape}")
    return between(a, b)


def normalized_errors(errors: ArrayLike, covariances: ArrayLike) -> Array:
    """``e^T S^-1 e`` for errors of shape (n, d) and their covariances, shape (n, d, d): shape (n,).

    For covariances that are right this is chi-square distributed with d degrees of freedom.
    Raises MapmendError for other shapes, and names the worst covariance if one is not positive definite.
    """
    e, covariance = np.asarray(errors, dtype=np.float64), np.asarray(covariances, dtype=np.float64)
    if e.ndim != 2 or covariance.shape != (*e.shape, e.shape[1]):
        raise MapmendError(f"need errors (n, d) and covariances (n, d, d), got {e.shape} and {covariance.shape}")
    try:
        factors = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as failure:
        smallest = np.linalg.eigvalsh(covariance)[:, 0] if np.all(np.isfinite(covariance)) else np.zeros(0)
        which = f"covariance {int(np.argmin(smallest))}" if len(smallest) else "a covariance"
        raise MapmendError(f"{which} is not positive definite") from failure
    whitened = np.linalg.solve(factors, e[..., None])[..., 0]
    return np.sum(whitened**2, axis=-1)


def mean_nees_band(count: int, dof: int = 3, level: float = 0.95) -> tuple[float, float]:
    """The band (low, high) in which the mean of ``count`` independent normalized errors lies with probability
    ``level``.

    Below it the covariances are too large, above it too small. The mean times the count is chi-square distributed with
    ``count * dof`` degrees of freedom. Raises MapmendError unless count and dof are positive and 0 < level < 1.
    """
    if count < 1 or dof < 1 or not 0.0 < level < 1.0:
        raise MapmendError(f"need count >= 1, dof >= 1 and 0 < level < 1, got {count}, {dof}, {level}")
    from scipy.stats import chi2

    low, high = chi2.ppf([(1.0 - level) / 2.0, (1.0 + level) / 2.0], count * dof) / count
    return float(low), float(high)
