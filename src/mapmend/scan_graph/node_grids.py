"""Grids and clouds of points of several nodes: which nodes stand for a place, and what they saw in one frame."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mapmend.config import GridConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.scan_graph.chains import Chains
from mapmend.scan_graph.points import ScanPoints

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# The frame of a grid in the frame of the map.
ORIGIN = np.zeros(3)
# How many scans of one spot, taken in about one direction, go into a grid.
CROWD = 1
# Every third point of a stretch is enough to verify a match of the whole stretch.
RECENT_STRIDE = 3


def insert_nodes(grid: SurfaceGrid, points: ScanPoints, nodes: Iterable[int], poses: Float) -> None:
    """Inserts the scans of ``nodes`` (n,) into a grid, at ``poses`` (n, 3) in its frame."""
    for node, pose in zip(nodes, poses, strict=True):
        grid.insert(points.of(int(node)), points.laser_origin(int(node)), pose)


def representatives(poses: Float, settings: GridConfig, crowd: dict[tuple[int, ...], int]) -> NDArray[np.bool_]:
    """Which of ``poses`` (n, 3) show something new: at most ``CROWD`` from a spot in one direction.

    So the cost of building a grid follows the area, not the length of the log. ``crowd`` counts the poses of each spot
    so far, and is written.
    """
    room = np.zeros(len(poses), dtype=np.bool_)
    size = (settings.spot_m, settings.spot_m, settings.spot_rad)
    for row, spot in enumerate(map(tuple, np.floor(poses / size).astype(np.int64).tolist())):
        crowd[spot] = crowd.get(spot, 0) + 1
        room[row] = crowd[spot] <= CROWD
    return room


def recent_points(chains: Chains, points: ScanPoints, length_m: float, last: int) -> Float:
    """Every third point of the ``length_m`` of trajectory up to node ``last``, in its frame; shape (n, 5)."""
    first, _ = chains.within(last, length_m, 0.0)
    parts = []
    for node in range(first, last + 1):
        pose = se2.between(chains.poses[last], chains.poses[node])
        part = points.of(node)[::RECENT_STRIDE]
        normals = se2.transform_points(np.array([0.0, 0.0, pose[2]]), part[:, 2:4])
        parts.append(np.concatenate((se2.transform_points(pose, part[:, :2]), normals, part[:, 4:]), axis=1))
    return np.ascontiguousarray(np.concatenate(parts))
