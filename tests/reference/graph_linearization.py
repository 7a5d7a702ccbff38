"""The plain twin of the graph kernels: one edge at a time, dense matrices, nothing but the definitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph

Array = NDArray[np.float64]


def error(pose_i: Array, pose_j: Array, measurement: Array) -> Array:
    """``measurement^-1 * (X_i^-1 * X_j)`` as a vector, shape (3,)."""
    return se2.compose(se2.inverse(measurement), se2.compose(se2.inverse(pose_i), pose_j))


def jacobians(pose_i: Array, pose_j: Array, measurement: Array) -> tuple[Array, Array]:
    """The derivatives of ``error`` by motions of i and of j in their own frames, each (3, 3)."""
    angle = error(pose_i, pose_j, measurement)[2]
    by_j = np.eye(3)
    by_j[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    # What i does in its own frame, j does the other way round in its own.
    return -by_j @ se2.adjoint(se2.between(pose_j, pose_i)), by_j


def dense_system(graph: PoseGraph) -> tuple[float, Array, Array]:
    """chi2, H of shape (3n, 3n) and the gradient, shape (3n,), over all nodes, the fixed ones included."""
    n = len(graph)
    chi2, H, gradient = 0.0, np.zeros((3 * n, 3 * n)), np.zeros(3 * n)
    for (i, j), measurement, information in zip(graph.edges, graph.measurements, graph.information, strict=True):
        e = error(graph.poses[i], graph.poses[j], measurement)
        J = np.zeros((3, 3 * n))
        J[:, 3 * i : 3 * i + 3], J[:, 3 * j : 3 * j + 3] = jacobians(graph.poses[i], graph.poses[j], measurement)
        chi2 += e @ information @ e
        H += J.T @ information @ J
        gradient += J.T @ information @ e
    return chi2, H, gradient


def free_rows(graph: PoseGraph) -> NDArray[np.int64]:
    """The rows of the dense system that belong to nodes which are not fixed."""
    nodes = np.setdiff1d(np.arange(len(graph)), graph.fixed)
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def dense_covariance(graph: PoseGraph) -> Array:
    """``H^-1`` over all nodes, shape (3n, 3n), zero in the rows and columns of fixed ones."""
    rows = free_rows(graph)
    H = dense_system(graph)[1]
    covariance = np.zeros_like(H)
    covariance[np.ix_(rows, rows)] = np.linalg.inv(H[np.ix_(rows, rows)])
    return covariance


def gauss_newton(graph: PoseGraph, iterations: int = 30) -> PoseGraph:
    """The optimum by dense Gauss-Newton steps, all of them taken."""
    rows = free_rows(graph)
    for _ in range(iterations):
        _, H, gradient = dense_system(graph)
        step = np.zeros(3 * len(graph))
        step[rows] = np.linalg.solve(H[np.ix_(rows, rows)], -gradient[rows])
        graph = graph.with_poses(se2.compose(graph.poses, step.reshape(-1, 3)))
    return graph
