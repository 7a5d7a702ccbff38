"""Rebuilding of the graph and its grids from the optimizer's poses. IGO Algorithm 1, lines 1 to 23."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mapmend.igo.loop_pass import LoopPass
from mapmend.igo.observed import Bool, Float
from mapmend.igo.odometry_pass import OdometryPass
from mapmend.parallel import Progress, no_progress
from mapmend.scan_graph.loop_edges import LoopEdge
from mapmend.scan_graph.scan_graph import ScanGraph


@dataclass(frozen=True)
class BiasedEdge:
    """A biased edge: its nodes, its old measurement (3,) and the new one, None if it was removed."""

    first: int
    last: int
    is_loop: bool
    before: Float
    after: Float | None

    def to_json(self) -> dict[str, Any]:
        """The same as JSON has it."""
        after = None if self.after is None else self.after.tolist()
        return {
            "nodes": [self.first, self.last],
            "is_loop": self.is_loop,
            "before": self.before.tolist(),
            "after": after,
        }


@dataclass(frozen=True)
class Round:
    """Counts of one rebuild: edges matched again, of these changed, of these accepted, and loop edges dropped."""

    matched: int
    changed: int
    accepted: int
    dropped: int
    biased: list[BiasedEdge]

    def to_json(self) -> dict[str, Any]:
        """The same as JSON has it."""
        counts = {"matched": self.matched, "changed": self.changed, "accepted": self.accepted, "dropped": self.dropped}
        return {**counts, "biased": [edge.to_json() for edge in self.biased]}


class Rebuilder:
    """Rebuilds a graph of scans repeatedly; edges that were found unchanged are not matched again (IGO IV-D)."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._odometry = OdometryPass(graph)
        self._loops = LoopPass(graph)
        self._odometry_wanted: Bool = self._odometry.can_match()
        self._loops_wanted: Bool = np.ones(len(graph.loops), dtype=np.bool_)

    def rebuild(self, loop_weights: Float, progress: Progress = no_progress) -> Round:
        """One round, from the nodes' poses; ``loop_weights`` (k,): the robust kernel's factor on each loop edge."""
        graph, chains = self._graph, self._graph.chains
        optimized = chains.poses.copy()
        odometry = self._odometry.run(self._odometry_wanted, progress)
        biased = [BiasedEdge(j - 1, j, False, chains.edges[j].copy(), new.motion) for j, new in odometry.edges.items()]
        if odometry.edges:
            chains.move(odometry.poses)
            chains.replace(odometry.edges)
        graph.key_nodes.forget_grids()
        loops = self._loops.run(self._loops_wanted, loop_weights, optimized, progress)
        biased += self._biased_loops(loops.loops, loops.rows, loops.changed)
        # At the poses where the loops agreed: from the rebuilt poses, the kernel would doubt every loop that has to
        # close.
        chains.move(optimized)
        dropped = len(graph.loops) - len(loops.loops)
        graph.loops[:] = loops.loops
        self._odometry_wanted = odometry.unsettled
        self._loops_wanted = loops.changed
        moved = int(loops.changed.sum())
        return Round(
            matched=odometry.matched + loops.matched,
            changed=odometry.changed + moved + dropped,
            accepted=len(odometry.edges) + moved + dropped,
            dropped=dropped,
            biased=biased,
        )

    def _biased_loops(self, loops: list[LoopEdge], rows: list[int], changed: Bool) -> list[BiasedEdge]:
        old = self._graph.loops
        found = [
            BiasedEdge(new.anchor, new.node, True, old[row].T_anchor_node, new.T_anchor_node)
            for new, row, differs in zip(loops, rows, changed, strict=True)
            if differs
        ]
        gone = sorted(set(range(len(old))) - set(rows))
        return found + [BiasedEdge(old[r].anchor, old[r].node, True, old[r].T_anchor_node, None) for r in gone]
