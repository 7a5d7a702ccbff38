"""Graphs with more noise in their measured angles, which gives the optimizer local optima to end in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.starts import starting_poses


def with_angle_noise(graph: PoseGraph, sigma_rad: float, seed: int, start: str = "odometry") -> PoseGraph:
    """The graph with Gaussian noise of ``sigma_rad`` added to every measured angle.

    Its poses are those of the ``start`` (``graph.starts.STARTS``), so that they carry the noise too. The information
    stays as it is.
    """
    measurements = graph.measurements.copy()
    measurements[:, 2] += np.random.default_rng(seed).normal(0.0, sigma_rad, len(measurements))
    noisy = replace(graph, measurements=measurements)
    return noisy.with_poses(starting_poses(noisy, start))
