"""Optimize, rebuild from the result, optimize again, until chi2 settles. IGO Algorithm 1, lines 24 to 34."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mapmend.graph.optimizer import OptimizationResult, optimize
from mapmend.graph.robust import DynamicCovarianceScaling
from mapmend.igo.observed import Float
from mapmend.igo.rebuild import Rebuilder, Round
from mapmend.parallel import Progress, no_progress
from mapmend.scan_graph.scan_graph import ScanGraph

# The kernel against false loops, a weakness of the paper's method: true loops keep their full weight under it.
KERNEL = DynamicCovarianceScaling()


@dataclass(frozen=True)
class Iteration:
    """What the iteration did: its rounds, and chi2 after each optimization, the first before any rebuild."""

    rounds: list[Round]
    chi2: list[float]

    def to_json(self) -> dict[str, Any]:
        """The same as JSON has it."""
        return {"chi2": self.chi2, "rounds": [one.to_json() for one in self.rounds]}


def iterate(graph: ScanGraph, progress: Progress = no_progress) -> Iteration:
    """Algorithm 1 on any graph of scans, which then holds the mended edges with its nodes at the best poses."""
    settings = graph.config.igo
    result = optimize_graph(graph)
    chi2, rounds = [result.cost_final], []
    rebuilder = Rebuilder(graph)
    for turn in range(1, settings.rounds + 1):
        rebuilt = rebuilder.rebuild(loop_weights(graph, result), told_by_round(progress, turn))
        rounds.append(rebuilt)
        if not rebuilt.accepted:
            break
        result = optimize_graph(graph)
        chi2.append(result.cost_final)
        if _has_settled(graph, chi2[-2], chi2[-1]):
            break
    graph.key_nodes.forget_grids()
    return Iteration(rounds, chi2)


def _has_settled(graph: ScanGraph, before: float, now: float) -> bool:
    """Whether chi2 changes so little that no edge is left to move.

    Where information is right, chi2 is about the number of nodes, and less than a share of that is settled. Another
    system's information has any scale: there, chi2 must go on falling by that share of itself.
    """
    share = graph.config.igo.settled_share
    if graph.keeps_information:
        return before - now < share * before
    return abs(now - before) < share * max(before, float(len(graph)))


def told_by_round(progress: Progress, turn: int) -> Progress:
    """The same progress, with the round in the name of each stage."""
    return lambda stage, done, total: progress(f"{stage}, round {turn}", done, total)


def optimize_graph(graph: ScanGraph) -> OptimizationResult:
    """The optimum of the current graph, with the robust kernel on loop edges; the nodes are moved there."""
    result = optimize(graph.pose_graph(), kernel=KERNEL)
    graph.chains.move(result.poses)
    return result


def loop_weights(graph: ScanGraph, result: OptimizationResult) -> Float:
    """The kernel's factors on the loop edges, which are last in the graph."""
    return result.edge_weights[len(result.edge_weights) - len(graph.loops) :]
