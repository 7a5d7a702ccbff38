"""Graphs that the tests of the back end share."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.g2o import read_g2o

Array = NDArray[np.float64]


def random_information(generator: np.random.Generator, count: int) -> Array:
    """Positive definite matrices, shape (count, 3, 3), with standard deviations of some centimetres and degrees."""
    factor = 0.4 * generator.normal(size=(count, 3, 3)) + 2.0 * np.eye(3)
    return 400.0 * factor @ np.swapaxes(factor, 1, 2)


def random_graph(seed: int, nodes: int = 12, loops: int = 8, noise: float = 1.0) -> PoseGraph:
    """A walk with loops between any of its nodes, some of them backwards, some of them double.

    ``noise`` is in standard deviations of the measurements; the poses are the true ones.
    """
    generator = np.random.default_rng(seed)
    poses = np.zeros((nodes, 3))
    for k in range(1, nodes):
        poses[k] = se2.compose(poses[k - 1], [1.0, 0.2 * generator.normal(), generator.uniform(-1.0, 1.0)])
    chain = np.stack((np.arange(nodes - 1), np.arange(1, nodes)), axis=1)
    first = generator.integers(0, nodes, size=loops)
    second = (first + generator.integers(1, nodes, size=loops)) % nodes
    edges = np.concatenate((chain, np.stack((first, second), axis=1))).astype(np.int64)
    information = random_information(generator, len(edges))
    spread = np.linalg.cholesky(np.linalg.inv(information))
    draws = noise * np.einsum("mij,mj->mi", spread, generator.normal(size=(len(edges), 3)))
    measurements = se2.compose(se2.between(poses[edges[:, 0]], poses[edges[:, 1]]), draws)
    is_loop = np.arange(len(edges)) >= nodes - 1
    return PoseGraph(poses, 10 * np.arange(nodes) + 7, edges, measurements, information, is_loop)


def grid_graph(side: int) -> PoseGraph:
    """A square grid of nodes, a metre apart, each joined to its neighbours by true measurements."""
    row, column = np.divmod(np.arange(side * side), side)
    poses = np.column_stack((column, row, np.zeros(side * side))).astype(np.float64)
    vertices = np.arange(side * side).reshape(side, side)
    pairs = [np.stack((vertices[:, :-1].ravel(), vertices[:, 1:].ravel()), axis=1)]
    pairs.append(np.stack((vertices[:-1].ravel(), vertices[1:].ravel()), axis=1))
    edges = np.concatenate(pairs).astype(np.int64)
    information = random_information(np.random.default_rng(0), len(edges))
    measurements = se2.between(poses[edges[:, 0]], poses[edges[:, 1]])
    return PoseGraph(poses, vertices.ravel(), edges, measurements, information, np.diff(edges)[:, 0] > 1)


def consistent(graph: PoseGraph) -> PoseGraph:
    """The same graph, its measurements those of its poses."""
    seen = se2.between(graph.poses[graph.edges[:, 0]], graph.poses[graph.edges[:, 1]])
    return replace(graph, measurements=seen)


def perturbed(graph: PoseGraph, seed: int, spread: float) -> PoseGraph:
    """The same graph, each node but the fixed ones moved by some ``spread`` metres and radians."""
    moves = np.random.default_rng(seed).normal(scale=spread, size=graph.poses.shape)
    moves[list(graph.fixed)] = 0.0
    return graph.with_poses(se2.compose(graph.poses, moves))


def read_public_graph(name: str) -> PoseGraph:
    """One of the public g2o graphs; skips the test where they are not at hand."""
    folder = os.environ.get("MAPMEND_DATA")
    if not folder:
        pytest.skip("MAPMEND_DATA is not set: no public graphs")
    if numba.config.DISABLE_JIT:
        pytest.skip("a public graph takes minutes with the compiler off")
    return read_g2o(Path(folder) / "posegraphs" / f"{name}.g2o.gz")
