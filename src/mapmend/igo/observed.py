"""The information of matches on the edges between successive nodes, and the axes that they leave open."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo import _kernels
from mapmend.matching.gauss_newton import Match

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
Int = NDArray[np.int64]

# The information that scan and grid have in common must exceed its own noise by this many standard deviations ...
BEYOND_NOISE = 2.0
# ... and be that of at least this many points, because two may agree by chance.
FEWEST_SHARED = 2.0


@dataclass
class MatchedEdges:
    """The last match of every odometry edge; row j is the edge from node j - 1 to node j.

    ``motions`` (n, 3): in the frame of node j - 1. ``information`` (n, 3, 3): of the match alone, in the frame of node
    j, nothing along axes that it leaves open. ``covariances`` (n, 3, 3): IGO's Sigma_obs. ``open_axes`` (n, 2): the
    direction along which nothing constrains the match, in the frame of node j, zero if there is none. ``scores`` (n,).
    ``renewed`` (n,): the share of what the grid remembers that one more scan replaces.
    """

    motions: Float
    information: Float
    covariances: Float
    open_axes: Float
    scores: Float
    renewed: Float

    @classmethod
    def of_nothing(cls, n: int) -> MatchedEdges:
        squares = np.zeros((2, n, 3, 3))
        return cls(np.zeros((n, 3)), squares[0], squares[1], np.zeros((n, 2)), np.zeros(n), np.zeros(n))

    @property
    def is_open(self) -> Bool:
        """Which edges have an open axis, shape (n,)."""
        return np.asarray(self.open_axes.any(axis=1))


class Observer:
    """Finds the axes that a match leaves open: those along which its information could be noise."""

    def __init__(self, config: Config) -> None:
        self._reach_m, self._half_weight_m = float(config.match.reach_m), float(config.match.half_weight_m)

    def information(self, grid: SurfaceGrid, points: Float, match: Match, point_variance: float) -> tuple[Float, Float]:
        """The information of a match in its own frame (3, 3), and the axis (2,) that it leaves open, zero if there is
        none.

        Along a bare corridor normals are noisy, and in the normal matrix their noise looks like information. Here the
        weakest axis has the information on which scan and grid agree (`_kernels.shared_normals`).
        """
        values, vectors = np.linalg.eigh(match.normal_matrix[:2, :2])
        weakest = np.ascontiguousarray(vectors[:, 0])
        found = _kernels.shared_normals(grid.tiles, points, match.pose, weakest, self._reach_m, self._half_weight_m)
        shared, noise = found.total, math.sqrt(found.squares)
        theta = float(match.pose[2])
        axis = turned(weakest, -theta)
        turn = np.eye(3)
        turn[:2, 0], turn[:2, 1] = turned(np.array([1.0, 0.0]), theta), turned(np.array([0.0, 1.0]), theta)
        normal = turn.T @ match.normal_matrix @ turn
        is_open = shared <= max(BEYOND_NOISE * noise, FEWEST_SHARED)
        share = 0.0 if is_open else min(shared / max(float(values[0]), 1e-12), 1.0)
        return cut_down(normal, axis, share) / point_variance, axis if is_open else np.zeros(2)


def cut_down(normal: Float, axis: Float, share: float) -> Float:
    """A normal matrix (3, 3) with only a share of its information along an axis of translation (2,), a unit vector.

    It is scaled from both sides: the coupling with the heading shrinks too, so that no direction falls below 0.
    """
    keep = np.eye(3)
    keep[:2, :2] -= (1.0 - np.sqrt(share)) * np.outer(axis, axis)
    return np.asarray(keep @ normal @ keep)


def turned(vector: Float, angle: float) -> Float:
    """A vector (2,) turned by an angle."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def without_gaps(marked: Bool) -> Bool:
    """Also marks a single edge between two that are marked: a few beams may look like a wall once."""
    filled = marked.copy()
    filled[1:-1] |= marked[:-2] & marked[2:]
    return filled


def runs(marked: Bool) -> list[tuple[int, int]]:
    """The stretches of True: the first row of each, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marked, [False])).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
