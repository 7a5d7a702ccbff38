"""Graphs of scans for tests: nodes at given poses, on the scans of a log."""

import numpy as np

from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.scan_graph.chains import OdometryEdge
from mapmend.scan_graph.scan_graph import ScanGraph
from tests.front_end.logs import empty_log


def graph_of(log, poses, covariance, drift=None, config=None):
    """A node for every scan of a log, at ``poses`` (n, 3); every odometry edge has the same covariance and drift."""
    graph = ScanGraph(config or Config(), log.scans.geometries)
    for k, pose in enumerate(np.asarray(poses, dtype=float)):
        add_node(graph, log, k, pose, covariance, covariance if drift is None else drift)
    return graph


def add_node(graph, log, scan, pose, covariance, drift):
    """Makes a scan of a log the next node, one step after the node before; True where it opens a key-node."""
    edge = OdometryEdge(se2.between(graph.chains.poses[-1], pose), covariance, drift) if len(graph) else None
    opens = graph.add_node(log.scans.ranges_of(scan), log.scans.laser_of(scan), pose, edge)
    graph.hung.hang(float(log.stamps_s[scan]), log.odometry[scan], graph.chains.last, np.zeros(3))
    return opens


def wander(seed, nodes=12, scans_between=4, drift_share=1.0):
    """Nodes some steps apart, ``scans_between`` scans on the way from each to the next; the graph, the scans' poses."""
    rng = np.random.default_rng(seed)
    log = empty_log((nodes - 1) * (scans_between + 1) + 1)
    graph = ScanGraph(Config(), log.scans.geometries)
    pose, scan, poses = rng.normal(size=3), 0, []
    for node in range(nodes):
        root = rng.normal(size=(3, 3)) + 4.0 * np.eye(3)
        covariance = np.linalg.inv(root @ root.T * 100.0)
        add_node(graph, log, scan, pose, covariance, drift_share * covariance)
        poses.append(pose)
        scan += 1
        step = np.array([0.3, 0.0, rng.uniform(-0.4, 0.4)])
        if node < nodes - 1:
            for k in range(scans_between):
                on_way = se2.compose(pose, step * (k + 1) / (scans_between + 1))
                graph.hung.hang(float(scan), np.zeros(3), node, se2.between(pose, on_way))
                poses.append(on_way)
                scan += 1
            pose = se2.compose(pose, step)
    return graph, np.array(poses)
