"""The solutions that a kernel gives for many values of its parameter, all from the same start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.robust import kernel_of
from mapmend.graph.system import System
from mapmend.parallel import Progress, map_in_order, no_progress

Float = NDArray[np.float64]

VALUES_A_PIECE = 4
"""Solves in succession with one analysis of the graph, because the analysis takes about as long as one step."""


@dataclass(frozen=True)
class Solution:
    """``poses``: (n, 3). ``edge_weights``: (m,), the kernel's factor on the information of every edge."""

    phi: float
    poses: Float
    edge_weights: Float


def solve(
    start: PoseGraph,
    kernel: str,
    phis: list[float],
    *,
    threads: int = 1,
    stage: str = "solve",
    progress: Progress = no_progress,
) -> list[Solution | MapmendError]:
    """The optimum nearest to ``start.poses`` for each value of phi, or the reason why there is none.

    ``kernel``: a name of ``graph.robust.KERNELS``. At phi = 0 no kernel trusts a loop, so the loops are left out. The
    result is the same for any number of threads.
    """
    pieces = [phis[k : k + VALUES_A_PIECE] for k in range(0, len(phis), VALUES_A_PIECE)]

    def work(piece: list[float]) -> list[Solution | MapmendError]:
        system = System(start)
        return [_solve(start, kernel, phi, system) for phi in piece]

    parts = map_in_order(work, pieces, threads, stage, progress)
    return [solution for part in parts for solution in part]


def _solve(start: PoseGraph, kernel: str, phi: float, system: System) -> Solution | MapmendError:
    try:
        if phi == 0.0:
            weights = np.where(start.is_loop, 0.0, 1.0)
            return Solution(phi, optimize(start.with_edges(~start.is_loop)).poses, weights)
        result = optimize(start, system=system, kernel=kernel_of(kernel, phi))
    except MapmendError as error:
        return error
    return Solution(phi, result.poses, result.edge_weights)
