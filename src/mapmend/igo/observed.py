"""What matches know of the edges between successive nodes, and what they leave open."""

from __future__ import annotations

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

# What scan and grid agree on must exceed its own noise by so many standard deviations ...
BEYOND_NOISE = 2.0
# ... and be worth so many points: two that agree by chance are nothing to go by.
FEWEST_SHARED = 2.0


@dataclass
class MatchedEdges:
    """What the last match of every odometry edge said; row j is the edge from node j - 1 to node j.

    ``motions`` (n, 3): in the frame of node j - 1. ``information`` (n, 3, 3): of the match alone, in the frame of node
    j, nothing along axes that it leaves open. ``covariances`` (n, 3, 3): IGO's Sigma_obs. ``open_axes`` (n, 2): the
    direction along which nothing holds the match, in the frame of node j, zero where there is none. ``scores`` (n,).
    """

    motions: Float
    information: Float
    covariances: Float
    open_axes: Float
    scores: Float

    @classmethod
    def of_nothing(cls, n: int) -> MatchedEdges:
        return cls(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, 3)), np.zeros((n, 2)), np.zeros(n))

    @property
    def is_open(self) -> Bool:
        """Which edges have an open axis, shape (n,)."""
        return np.asarray(self.open_axes.any(axis=1))


class Observer:
    """Says which axes a match leaves open: those along which what it knows could be noise."""

    def __init__(self, config: Config) -> None:
        self._settings = np.array([config.grid.cell_size_m, config.match.reach_m, config.match.half_weight_m])
        self._result = np.zeros(2)

    def information(self, grid: SurfaceGrid, points: Float, match: Match) -> tuple[Float, Float]:
        """What a match knows in its own frame (3, 3), and the axis (2,) that it leaves open, zero where it leaves none.

        Along a bare corridor normals are noisy, and in the normal matrix their noise looks like information. Here the
        weakest axis has the information on which scan and grid agree (`_kernels.shared_normals`).
        """
        values, vectors = np.linalg.eigh(match.normal_matrix[:2, :2])
        weakest = np.ascontiguousarray(vectors[:, 0])
        _kernels.shared_normals(
            grid.table, grid.frame, grid.arrays, points, match.pose, weakest, self._settings, self._result
        )
        shared, noise = float(self._result[0]), float(np.sqrt(self._result[1]))
        theta = float(match.pose[2])
        axis = turned(weakest, -theta)
        turn = np.eye(3)
        turn[:2, 0], turn[:2, 1] = turned(np.array([1.0, 0.0]), theta), turned(np.array([0.0, 1.0]), theta)
        normal = turn.T @ match.normal_matrix @ turn
        is_open = shared <= max(BEYOND_NOISE * noise, FEWEST_SHARED)
        share = 0.0 if is_open else min(shared / max(float(values[0]), 1e-12), 1.0)
        return cut_down(normal, axis, share) / match.variance(), axis if is_open else np.zeros(2)


def cut_down(normal: Float, axis: Float, share: float) -> Float:
    """A normal matrix (3, 3) that knows of an axis of translation (2,), a unit vector, only a share of what it did.

    From both sides: what the axis has in common with the heading shrinks along, so that no direction falls below 0.
    """
    keep = np.eye(3)
    keep[:2, :2] -= (1.0 - np.sqrt(share)) * np.outer(axis, axis)
    return np.asarray(keep @ normal @ keep)


def turned(vector: Float, angle: float) -> Float:
    """A vector (2,) turned by an angle."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def without_gaps(marked: Bool) -> Bool:
    """Marks also a lone edge between two that are marked: a few beams may look like a wall for once."""
    filled = marked.copy()
    filled[1:-1] |= marked[:-2] & marked[2:]
    return filled


def runs(marked: Bool) -> list[tuple[int, int]]:
    """The stretches of True: the first row of each, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marked, [False])).astype(np.int8)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
