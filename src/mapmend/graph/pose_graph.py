"""The data structure in which both papers meet: a pose graph whose nodes may carry scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.scan import Note, Scans

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@dataclass(frozen=True)
class PoseGraph:
    """n nodes, m edges; an edge measures ``T_i_j`` of nodes ``i = edges[k, 0]``, ``j = edges[k, 1]`` (row numbers).

    ``poses``: shape (n, 3), ``T_map_robot``. ``ids``: shape (n,), the nodes' names in files, unique.
    ``edges``: int64, shape (m, 2). ``measurements``: shape (m, 3). ``information``: shape (m, 3, 3), symmetric positive
    definite, in the frame of the measured pose (g2o's convention: the error is ``measurement^-1 * T_i_j``).
    ``is_loop``: bool, shape (m,). ``scans`` has n rows, a node without a scan an empty one. ``stamps_s``: shape (n,).
    ``notes`` describe what was odd about the file that the graph comes from.
    """

    poses: Float
    ids: Int
    edges: Int
    measurements: Float
    information: Float
    is_loop: NDArray[np.bool_]
    scans: Scans | None = None
    stamps_s: Float | None = None
    fixed: tuple[int, ...] = (0,)
    notes: tuple[Note, ...] = ()

    def __post_init__(self) -> None:
        n, m = len(self.poses), len(self.edges)
        shapes = {
            "poses": (self.poses.shape, (n, 3)),
            "ids": (self.ids.shape, (n,)),
            "edges": (self.edges.shape, (m, 2)),
            "measurements": (self.measurements.shape, (m, 3)),
            "information": (self.information.shape, (m, 3, 3)),
            "is_loop": (self.is_loop.shape, (m,)),
        }
        for name, (got, expected) in shapes.items():
            if got != expected:
                raise MapmendError(f"{name} must have shape {expected}, got {got}")
        if m and (self.edges.min() < 0 or self.edges.max() >= n):
            raise MapmendError(f"an edge names a node outside 0..{n - 1}")
        if self.scans is not None and len(self.scans) != n:
            raise MapmendError(f"{len(self.scans)} scans for {n} nodes")
        if self.stamps_s is not None and self.stamps_s.shape != (n,):
            raise MapmendError(f"stamps_s must have shape ({n},), got {self.stamps_s.shape}")

    def __len__(self) -> int:
        return len(self.poses)

    def with_poses(self, poses: Float) -> PoseGraph:
        """The same graph with other poses; ``poses`` has shape (n, 3)."""
        return replace(self, poses=poses)

    def with_order(self, rows: Int) -> PoseGraph:
        """The same graph with its nodes in another order; ``rows`` (n,): the present row of the first node, of the
        second, ..."""
        place = np.empty(len(rows), dtype=np.int64)
        place[rows] = np.arange(len(rows))
        return replace(
            self,
            poses=self.poses[rows],
            ids=self.ids[rows],
            edges=place[self.edges],
            scans=None if self.scans is None else self.scans.select(rows),
            stamps_s=None if self.stamps_s is None else self.stamps_s[rows],
            fixed=tuple(place[list(self.fixed)].tolist()),
        )

    def with_edges(self, kept: NDArray[np.bool_]) -> PoseGraph:
        """The same nodes with some of the edges; ``kept`` has shape (m,)."""
        return replace(
            self,
            edges=self.edges[kept],
            measurements=self.measurements[kept],
            information=self.information[kept],
            is_loop=self.is_loop[kept],
        )
