"""Scans to compare: of any laser, at any place, with or without returns."""

import numpy as np

from mapmend.graph.pose_graph import PoseGraph
from mapmend.scan import LaserGeometry, Scans

HALF_CIRCLE = LaserGeometry(60, -np.pi / 2.0, np.pi / 59.0, 20.0)
ALL_AROUND = LaserGeometry(72, -np.pi, np.pi / 36.0, 20.0, (0.1, -0.2, 0.3))
ONCE_MORE = LaserGeometry(73, -np.pi, np.pi / 36.0, 20.0)  # the last beam looks where the first one does
TOO_FAR_AROUND = LaserGeometry(80, 0.5, np.pi / 36.0, 20.0)
CLOCKWISE = LaserGeometry(50, 2.2, -0.09, 20.0)
NARROW = LaserGeometry(9, 2.9, 0.07, 20.0)
THREE = LaserGeometry(3, 0.0, 2.0 * np.pi / 3.0, 20.0)
LASERS = (HALF_CIRCLE, ALL_AROUND, ONCE_MORE, TOO_FAR_AROUND, CLOCKWISE, NARROW, THREE)


def scans_of(geometries, readings):
    """Scans, one for each geometry and row of readings."""
    counts = [len(r) for r in readings]
    offsets = np.concatenate(([0], np.cumsum(counts))).astype(np.int64)
    ranges = (
        np.concatenate([np.asarray(r, dtype=np.float32) for r in readings]) if readings else np.zeros(0, np.float32)
    )
    return Scans(ranges, offsets, np.arange(len(readings), dtype=np.int32), tuple(geometries))


def random_readings(rng, count):
    """Walls, jumps, beams without return and unusable ones."""
    readings = rng.uniform(0.5, 6.0) + np.cumsum(rng.normal(0.0, 0.1, count))
    readings = np.clip(readings + rng.choice((0.0, 3.0), count, p=(0.9, 0.1)), 0.1, 12.0)
    readings[rng.random(count) < 0.1] = np.inf
    readings[rng.random(count) < 0.03] = np.nan
    return readings


def room_graph(nodes=12, seed=0, noise_m=0.01, with_loop=True):
    """A robot that goes back and forth in a room of 6 m x 4 m; poses are true, edges exact, the scans noisy."""
    from mapmend.simulation.ray_casting import cast_rays

    rng = np.random.default_rng(seed)
    corners = np.array([(0, 0), (6, 0), (6, 4), (3.5, 4), (3.5, 2.8), (3, 2.8), (3, 4), (0, 4)], dtype=np.float64)
    walls = np.hstack((corners, np.roll(corners, -1, axis=0)))
    x = 1.0 + 3.0 * np.abs(np.linspace(-1.0, 1.0, nodes))
    poses = np.column_stack((x, np.full(nodes, 1.5), np.linspace(0.0, 2.0, nodes)))
    geometry = LaserGeometry(180, -np.pi / 2.0, np.pi / 180.0, 20.0)
    ranges = cast_rays(walls, poses, geometry.bearings_rad(), 20.0)
    ranges = (ranges + noise_m * rng.standard_normal(ranges.shape)).astype(np.float32)
    offsets = np.arange(nodes + 1, dtype=np.int64) * 180
    scans = Scans(ranges.ravel(), offsets, np.zeros(nodes, np.int32), (geometry,))
    return graph_of(poses, scans, [(0, nodes - 1)] if with_loop else [])


def graph_of(poses, scans, loops=(), stamps_s=None):
    """A graph whose edges follow from its poses: odometry from node to node, and the given loops."""
    from mapmend.geometry import se2

    n = len(poses)
    edges = np.array([(k, k + 1) for k in range(n - 1)] + list(loops), dtype=np.int64).reshape(-1, 2)
    return PoseGraph(
        poses=np.asarray(poses, dtype=np.float64),
        ids=np.arange(n) * 10,
        edges=edges,
        measurements=se2.between(poses[edges[:, 0]], poses[edges[:, 1]]),
        information=np.tile(np.diag((1e4, 1e4, 1e5)), (len(edges), 1, 1)),
        is_loop=np.arange(len(edges)) >= n - 1,
        scans=scans,
        stamps_s=stamps_s,
    )
