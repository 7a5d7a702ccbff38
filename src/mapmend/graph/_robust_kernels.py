"""Kernel of the robust back end: the errors and chi2 of all edges at given poses, without the normal equations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.kernel_cache import kernel

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@kernel
def edge_errors(poses: Float, edges: Int, measurements: Float, information: Float) -> tuple[Float, Float]:
    """``e = measurement^-1 * (X_i^-1 * X_j)`` of every edge, shape (m, 3), and ``e^T Omega e``, shape (m,)."""
    errors = np.empty((len(edges), 3))
    chi2 = np.empty(len(edges))
    for k in range(len(edges)):
        i, j = edges[k, 0], edges[k, 1]
        cos_i, sin_i = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        cos_m, sin_m = np.cos(measurements[k, 2]), np.sin(measurements[k, 2])
        dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
        x, y = cos_i * dx + sin_i * dy - measurements[k, 0], cos_i * dy - sin_i * dx - measurements[k, 1]
        errors[k, 0] = cos_m * x + sin_m * y
        errors[k, 1] = cos_m * y - sin_m * x
        errors[k, 2] = (poses[j, 2] - poses[i, 2] - measurements[k, 2] + np.pi) % (2.0 * np.pi) - np.pi
        total = 0.0
        for r in range(3):
            for s in range(3):
                total += errors[k, r] * information[k, r, s] * errors[k, s]
        chi2[k] = total
    return errors, chi2
