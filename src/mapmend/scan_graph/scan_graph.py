"""A graph of scans: nodes in chains, each with its scan, loop edges between them, and key-nodes to match on.

The front end builds one from a log, `from_pose_graph` from a pose graph that any system made; `igo` rebuilds it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.matching.gauss_newton import SurfaceMatcher
from mapmend.scan import LaserGeometry
from mapmend.scan_graph.chains import Chains, OdometryEdge
from mapmend.scan_graph.hung_scans import HungScans
from mapmend.scan_graph.key_nodes import KeyNodes
from mapmend.scan_graph.loop_edges import LoopEdge, LoopEdges
from mapmend.scan_graph.points import NodeScans, ScanPoints
from mapmend.scan_graph.sorted_edges import sort_edges

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int = NDArray[np.int64]


class ScanGraph:
    """``chains``: the nodes and odometry edges. ``hung``: the log's scans, each on a node. ``scans``, ``points``: those
    of the nodes. ``key_nodes``: stretches of the chains with a grid each. ``loops``: the loop edges. ``loop_edges``
    makes and verifies them. ``keeps_information``: an edge that is matched again keeps the information it had, for
    information from another system and ours have no common scale.
    """

    def __init__(self, config: Config, geometries: tuple[LaserGeometry, ...] = ()) -> None:
        self.config = config
        self.chains = Chains()
        self.hung = HungScans()
        self.scans = NodeScans(geometries)
        self.points = ScanPoints(self.scans, config.scan)
        self.matcher = SurfaceMatcher(config.match)
        self.key_nodes = KeyNodes(self.chains, self.points, config)
        self.loop_edges = LoopEdges(self.chains, self.key_nodes, self.matcher, config)
        self.loops: list[LoopEdge] = []
        self.keeps_information = False

    @classmethod
    def from_pose_graph(cls, graph: PoseGraph, config: Config) -> ScanGraph:
        """The graph of scans that a pose graph with scans on its nodes is, whatever system made it.

        Nodes follow each other in the order of their rows, by the odometry edges between neighbouring rows; where there
        is none, the chain is broken. What such an edge measures also stands for what the wheels reported. Further
        odometry edges are stretches, all others loop edges. Nothing is known of how errors of neighbouring edges
        cancel, so all of a covariance counts as drift. Raises MapmendError for a graph without scans.
        """
        if graph.scans is None or len(graph) == 0:
            raise MapmendError("the graph's nodes carry no scans; only a graph with scans can be rebuilt")
        scan_graph = cls(config, graph.scans.geometries)
        sorted_edges = sort_edges(graph)
        laid = np.zeros(3)
        stamps_s = np.arange(len(graph), dtype=np.float64) if graph.stamps_s is None else graph.stamps_s
        for k, pose in enumerate(graph.poses):
            edge = sorted_edges.odometry.get(k)
            laid = laid if edge is None else se2.compose(laid, edge.motion)
            scan_graph.add_node(graph.scans.ranges_of(k), graph.scans.laser_of(k), pose, edge)
            scan_graph.hung.hang(float(stamps_s[k]), laid, k, np.zeros(3))
        scan_graph.keeps_information = True
        scan_graph.chains.given_stretches = sorted_edges.stretches
        scan_graph.loops = sorted_edges.loops
        return scan_graph

    def __len__(self) -> int:
        return len(self.chains)

    def add_node(
        self, ranges_m: Float32, laser: int, pose: Float, edge: OdometryEdge | None, tracked: Float | None = None
    ) -> bool:
        """Makes the log's next scan a node at ``pose`` (3,); True if it opens a key-node. The scan is attached after
        it.

        ``edge``: from the node before it; None if a chain begins. ``tracked`` (3,): the motion from the node before it
        as it was found scan by scan; that of the edge if it is not given.
        """
        self.scans.add(ranges_m, laser)
        node = self.chains.begin(pose) if edge is None else self.chains.add(pose, edge)
        step = edge.motion if edge is not None and tracked is None else tracked
        self.hung.note_node(len(self.hung), None if edge is None else step)
        return self.key_nodes.add_node(node)

    def scan_poses(self) -> Float:
        """``T_map_robot`` of every scan of the log, shape (m, 3), with the nodes at their current poses."""
        return self.hung.scan_poses(self.chains.poses)

    def pose_graph(self, with_scans: bool = False) -> PoseGraph:
        """The graph of all nodes and edges: odometry, stretches, loops; with the scans if wanted."""
        chains, n = self.chains, len(self)
        chain = np.flatnonzero(chains.has_edge())
        stretches = [*chains.given_stretches, *chains.stretches]
        joined = [(e.first, e.last) for e in stretches] + [(e.anchor, e.node) for e in self.loops]
        measured = [e.T_first_last for e in stretches] + [e.T_anchor_node for e in self.loops]
        information = [e.information for e in stretches] + [e.information for e in self.loops]
        own = np.linalg.inv(chains.covariances[chain])
        return PoseGraph(
            poses=chains.poses.copy(),
            ids=np.arange(n, dtype=np.int64),
            edges=np.concatenate(
                (np.stack((chain - 1, chain), axis=1), np.array(joined, dtype=np.int64).reshape(-1, 2))
            ),
            measurements=np.concatenate((chains.edges[chain], np.array(measured).reshape(-1, 3))),
            information=np.concatenate((0.5 * (own + own.swapaxes(1, 2)), np.array(information).reshape(-1, 3, 3))),
            is_loop=np.arange(len(chain) + len(joined)) >= len(chain) + len(stretches),
            scans=self.scans.scans() if with_scans else None,
            stamps_s=self.hung.stamps_s[self.hung.node_scan],
        )
