"""Loop edges: how they are made from a match on a key-node's grid, and what verifies them. IGO section III-C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.gauss_newton import Match, SurfaceMatcher
from mapmend.scan_graph.chains import Chains
from mapmend.scan_graph.key_nodes import KeyNodes

Float = NDArray[np.float64]


@dataclass(frozen=True)
class LoopEdge:
    """A verified match of node ``node`` with the local grid of the key-node that node ``anchor`` belongs to."""

    anchor: int
    node: int
    T_anchor_node: Float
    information: Float


@dataclass(frozen=True)
class Agreement:
    """How many of ``points`` a grid confirms at a pose, and how many it contradicts; the rest it has not seen."""

    matched: int
    contradicted: int
    points: int

    @property
    def seen(self) -> int:
        return self.matched + self.contradicted

    @property
    def share(self) -> float:
        """The share of confirmed points among those that the grid has seen; 0 where it has seen none."""
        return self.matched / self.seen if self.seen else 0.0


class LoopEdges:
    """Makes and verifies the loop edges of a graph."""

    def __init__(self, chains: Chains, key_nodes: KeyNodes, matcher: SurfaceMatcher, config: Config) -> None:
        self._chains = chains
        self._key_nodes = key_nodes
        self._matcher = matcher
        self._config = config

    def certain(self) -> Float:
        """The covariance of a prior that is good enough for Gauss-Newton alone, shape (3, 3)."""
        loops = self._config.loops
        return np.diag([loops.certain_std_m**2, loops.certain_std_m**2, loops.certain_std_rad**2])

    def is_observed(self, match: Match) -> bool:
        """Whether the surfaces constrain the match in every direction: along a bare corridor only noisy normals do."""
        weakest = float(np.linalg.eigvalsh(match.normal_matrix[:2, :2])[0])
        return weakest >= self._config.loops.min_observability * match.matched

    def agreement(self, grid: SurfaceGrid, points: Float, pose: Float) -> Agreement:
        """Compares a grid with ``points`` (n, 5) of a node at a pose (3,) in the grid's frame."""
        matched, contradicted, _ = self._matcher.judge(grid, points, pose)
        return Agreement(matched, contradicted, len(points))

    def agrees(self, agreement: Agreement) -> bool:
        """Whether enough of the points that the grid has seen are confirmed."""
        return agreement.matched >= self._config.loops.min_agreement * agreement.seen

    def overlaps(self, agreement: Agreement) -> bool:
        """Whether the grid has seen enough of the points' area."""
        return agreement.seen >= self._config.loops.min_overlap * agreement.points

    def verified_share(self, key_node: int, match: Match, points: Float) -> float:
        """Of the ``points`` (n, 5) that the grid has seen, the share that it confirms; 0 if the match is not verified.

        A match is verified if the grid has seen enough of the points and confirms enough of these, and if the match is
        constrained in every direction.
        """
        agreement = self.agreement(self._key_nodes.local_grid(key_node).grid, points, match.pose)
        if not self.overlaps(agreement) or not self.agrees(agreement):
            return 0.0
        return agreement.share if self.is_observed(match) else 0.0

    def edge(self, anchor: int, match: Match, points: Float, node: int) -> LoopEdge:
        """The edge from ``anchor``, a node of the key-node on whose grid ``points`` (n, 5) of ``node`` were matched.

        The nearest node of the key-node makes the best anchor: the lever is short, and the bend of the grid small.
        """
        local = self._key_nodes.local_grid(int(self._key_nodes.of_node[anchor]))
        measured = se2.between(local.poses[anchor - local.begin], match.pose)
        covariance = self._matcher.uncertainty(local.grid, points, match).covariance + self._bend(anchor, measured)
        return LoopEdge(anchor, node, measured, se2.invert_symmetric(covariance))

    def _bend(self, anchor: int, T_anchor_node: Float) -> Float:
        """The uncertainty of the local grid itself, in the frame of the matched node, shape (3, 3).

        It was built from nodes along the trajectory: relative to one of them, a wall is as uncertain as the path to the
        node that saw it, which is on average half as long as the key-node. The noise of that node's own match does not
        count: the grid is the mean of what many nodes saw.
        """
        chains = self._chains
        _, after = chains.within(anchor, 0.0, 0.5 * self._config.key_nodes.trajectory_length_m)
        end = min(after, chains.chain_of(anchor)[1] - 1)
        chain = chains.covariance_between(anchor, end, of_last=False)
        carry = se2.adjoint(se2.between(T_anchor_node, se2.between(*chains.poses[[anchor, end]])))
        return np.asarray(carry @ chain @ carry.T)
