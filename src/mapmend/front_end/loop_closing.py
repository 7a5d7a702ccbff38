"""Loop search: distance, gate, interpolated guesses, the best match, its verification. IGO section III-C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from mapmend.front_end.relocation import MOST_DRIFT, Relocation
from mapmend.geometry import se2
from mapmend.graph.marginals import marginals, relative_covariances
from mapmend.graph.system import Factorization
from mapmend.matching.correlative import Region, search
from mapmend.matching.gauss_newton import prior_at
from mapmend.scan_graph.loop_edges import LoopEdge
from mapmend.scan_graph.node_grids import recent_points
from mapmend.scan_graph.scan_graph import ScanGraph

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Solved:
    """The last optimization: its factor, and the poses (n, 3) and marginals (n, 3, 3) of its nodes."""

    factorization: Factorization
    poses: Float
    covariances: Float

    @classmethod
    def from_factor(cls, factorization: Factorization, poses: Float) -> Solved:
        return cls(factorization, poses, marginals(factorization))


@dataclass(frozen=True)
class Candidate:
    """A key-node that the newest node may have come back to, and its nearest node."""

    key_node: int
    nearest: int


class LoopSearch:
    """Looks for loops of the newest node."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._chains = graph.chains
        self._key_nodes = graph.key_nodes
        self._verify = graph.loop_edges
        self._matcher = graph.matcher
        self._config = graph.config
        self._gate = float(chdtri(3, 1.0 - graph.config.loops.gate_quantile))
        self._tried_at_m: dict[tuple[int, int], float] = {}
        self.solved: Solved | None = None
        self._partner = -1
        self._awaiting: LoopEdge | None = None
        self._relocation = Relocation(graph)

    def find(self) -> list[LoopEdge]:
        """The verified loop edges of the newest node: at most one to a known and one to an unlinked key-node."""
        known = self._key_nodes.known()
        candidates = self._candidates(known)
        edges = [self._match_known(c) for c in self._preferred([c for c in candidates if c.key_node in known])]
        for candidate in [c for c in candidates if c.key_node not in known]:
            edge = self._match_uncertain(candidate)
            if edge is not None:
                return [edge for edge in [*edges, *self._confirmed(edge)] if edge is not None]
        return [edge for edge in [*edges, *self._relocated()] if edge is not None]

    def _relocated(self) -> list[LoopEdge]:
        """A loop beyond the reach of the search around the current pose, found on an old part of the map."""
        chains, here = self._chains, self._relocation.find()
        if here is None:
            return []
        old = int(np.searchsorted(chains.path_m, self._oldest_m()))
        nearest = int(np.argmin(np.hypot(*(chains.poses[:old, :2] - here[:2]).T)))
        candidate = Candidate(int(self._key_nodes.of_node[nearest]), nearest)
        # The stretch that was found, not the newest scan: on the way back, a robot may look at what it had never seen.
        points = self._recent_points()
        predicted = self._seen_from(candidate.key_node, here)
        prior = prior_at(predicted, self._verify.certain())
        match = self._matcher.match(self._key_nodes.local_grid(candidate.key_node).grid, points, predicted, prior)
        if not self._verify.verified_share(candidate.key_node, match, points):
            return []
        return self._confirmed(self._verify.edge(candidate.nearest, match, points, chains.last))

    def _oldest_m(self) -> float:
        """The path length up to which places were left long enough ago to form a loop."""
        return float(self._chains.path_m[-1]) - self._config.loops.min_separation_m

    def _confirmed(self, edge: LoopEdge) -> list[LoopEdge]:
        """A searched loop counts only when a second one, matched some metres farther on, agrees with it.

        Rooms repeat: one place may look like another in all that the robot saw in the last T_l metres. The next metres
        then differ.
        """
        first, chains = self._awaiting, self._chains
        if first is None:
            self._awaiting = edge
            return []
        way = float(chains.path_m[edge.node] - chains.path_m[first.node])
        if way < self._config.loops.confirm_after_m:
            return []
        poses = chains.poses
        ahead = se2.compose(first.T_anchor_node, se2.between(poses[first.node], poses[edge.node]))
        around = se2.compose(se2.between(poses[first.anchor], poses[edge.anchor]), edge.T_anchor_node)
        difference = se2.between(ahead, around)
        loops = self._config.loops
        agree = np.hypot(difference[0], difference[1]) < loops.confirm_m and abs(difference[2]) < loops.confirm_rad
        self._awaiting = None if agree else edge
        return [first, edge] if agree else []

    def _preferred(self, candidates: list[Candidate]) -> list[Candidate]:
        """One of the known ones: that of the previous node while it is still near, otherwise the nearest.

        If several passes of one corridor are side by side, the nearest changes with every node, and each change needs
        another local grid.
        """
        same = [c for c in candidates if c.key_node == self._partner]
        chosen = (same or candidates)[:1]
        self._partner = chosen[0].key_node if chosen else -1
        return chosen

    def _candidates(self, known: dict[int, float]) -> list[Candidate]:
        """Key-nodes within T_l, unknown ones also within the possible drift; nearest first."""
        loops, rows = self._config.loops, self._key_nodes.rows
        poses, path = self._chains.poses, self._chains.path_m
        here = poses[-1]
        old = int(np.searchsorted(path, self._oldest_m()))
        if old == 0:
            return []
        distance = np.hypot(poses[:old, 0] - here[0], poses[:old, 1] - here[1])
        starts = self._key_nodes.firsts()
        starts = starts[: int(np.searchsorted(starts, old))]
        nearest = np.minimum.reduceat(distance, starts)
        length = self._config.key_nodes.trajectory_length_m
        drift = np.minimum(3.0 * loops.drift_per_m * (path[-1] - path[starts]), MOST_DRIFT * length)
        count = len(starts)
        drift[[k for k in known if k < count]] = 0.0
        reach = length + drift
        found = []
        for k in np.nonzero(nearest < reach)[0]:
            first, end = starts[k], min(rows[k].end, old)
            found.append((float(nearest[k]), Candidate(int(k), int(first + np.argmin(distance[first:end])))))
        return [candidate for _, candidate in sorted(found, key=lambda pair: (pair[0], pair[1].key_node))]

    def _match_known(self, candidate: Candidate) -> LoopEdge | None:
        """A key-node whose pose is known well: a match from the node's own pose, or otherwise from a short search."""
        loops = self._config.loops
        covariance = self._verify.certain()
        predicted = self._predicted(candidate.key_node)
        local = self._key_nodes.local_grid(candidate.key_node)
        points = self._graph.points.of(self._chains.last)
        match = self._matcher.match(local.grid, points, predicted, prior_at(predicted, covariance))
        step = se2.between(predicted, match.pose)
        moved = max(np.hypot(step[0], step[1]) / loops.certain_std_m, abs(step[2]) / loops.certain_std_rad)
        agrees = self._verify.agrees(self._verify.agreement(local.grid, points, match.pose))
        if match.score >= loops.min_score and agrees and moved < 1.5:
            is_observed = self._verify.is_observed(match)
            return self._verify.edge(candidate.nearest, match, points, self._chains.last) if is_observed else None
        return None if agrees and moved < 1.5 else self._searched(candidate, covariance)

    def _match_uncertain(self, candidate: Candidate) -> LoopEdge | None:
        """A key-node that drift separates from here: gate, then search in the covariance ellipse."""
        covariance = self._relative_covariance(candidate)
        if not self._passes_gate(candidate, covariance):
            return None
        return self._searched(candidate, covariance)

    def _searched(self, candidate: Candidate, covariance: Float) -> LoopEdge | None:
        """The best-scoring match in the region around the newest node by ``covariance`` (3, 3), if it is verified."""
        loops, verify, last = self._config.loops, self._verify, self._chains.last
        pair = (candidate.key_node, self._key_nodes.last)
        path = float(self._chains.path_m[last])
        if path - self._tried_at_m.get(pair, -np.inf) < loops.retry_every_m:
            return None
        self._tried_at_m[pair] = path
        predicted = self._predicted(candidate.key_node)
        region = self._region(predicted, covariance)
        field, local = self._key_nodes.likelihood(candidate.key_node), self._key_nodes.local_grid(candidate.key_node)
        stretch = self._recent_points()
        points = self._graph.points.of(last)  # last: building the grid and the stretch projects other scans
        found = search(field, points, region, loops.min_likelihood)
        if found is None:
            return None
        match = self._matcher.match(local.grid, points, found[0], prior_at(found[0], covariance))
        share = verify.verified_share(candidate.key_node, match, stretch)
        if match.score < loops.min_score or not share:
            return None
        # Elsewhere more points may overlap, and agree by chance: a pose that is verified near the prediction is
        # preferred.
        near = self._matcher.match(local.grid, points, predicted, prior_at(predicted, covariance))
        if verify.verified_share(candidate.key_node, near, stretch) >= share:
            match = near
        # The next node may search again at once, because it may confirm this loop.
        del self._tried_at_m[pair]
        return verify.edge(candidate.nearest, match, points, last)

    def _predicted(self, key_node: int) -> Float:
        """The current pose of the newest node in the frame of a key-node's local grid."""
        return self._seen_from(key_node, self._chains.poses[-1])

    def _seen_from(self, key_node: int, pose: Float) -> Float:
        """A pose (3,) in the map, in the frame of a key-node's local grid."""
        return se2.between(self._chains.poses[self._key_nodes.rows[key_node].first], pose)

    def _relative_covariance(self, candidate: Candidate) -> Float:
        """S of IGO (4), in the frame of the newest node: exact at the last factorization, along the chain since then.

        A guard is added against over-confident edges: a drift in proportion to the path.
        """
        chains, solved = self._chains, self.solved
        node = candidate.nearest
        if solved is None or node >= len(solved.poses):
            covariance = chains.covariance_between(node, chains.last)
        else:
            newest = len(solved.poses) - 1
            first = relative_covariances(
                solved.factorization, solved.poses, solved.covariances, newest, np.array([node])
            )[0]
            T_newest_last = se2.between(chains.poses[newest], chains.poses[-1])
            since = chains.covariance_between(newest, chains.last)
            covariance = se2.compose_covariance(first, T_newest_last, since)
        guard_m, guard_rad = self._drift(node)
        return np.asarray(covariance + np.diag([guard_m**2, guard_m**2, guard_rad**2]))

    def _drift(self, node: int) -> tuple[float, float]:
        """The possible drift since ``node``, or since the last loop if that is later: metres, radians."""
        path, loops = self._chains.path_m, self._config.loops
        since = max([node] + [edge.node for edge in self._graph.loops[-1:]])
        drift = loops.drift_per_m * float(path[-1] - path[since])
        # A heading error of drift / way moves the far end by the drift; it is limited to that of 30 m.
        turn = min(drift, 30.0 * loops.drift_per_m) / 3.0
        return max(drift, loops.certain_std_m), max(turn, loops.certain_std_rad)

    def _passes_gate(self, candidate: Candidate, covariance: Float) -> bool:
        """IGO (5) with the inverse on the covariance, and with a term for two poses that see the same walls from
        afar."""
        poses, loops = self._chains.poses, self._config.loops
        error = se2.between(poses[candidate.nearest], poses[-1])
        # The error, as a motion at the newest node; with any headings, two poses may see the same walls.
        step = -se2.inverse(error)
        view = np.diag([loops.view_std_m**2, loops.view_std_m**2, np.pi**2])
        return bool(step @ np.linalg.solve(covariance + view, step) < self._gate)

    def _region(self, predicted: Float, covariance: Float) -> Region:
        """Guesses every 5 cm towards the key-node, within the covariance ellipse; the discs cover its width."""
        loops = self._config.loops
        cos, sin = np.cos(predicted[2]), np.sin(predicted[2])
        turn = np.array([[cos, -sin], [sin, cos]])
        ellipse = turn @ covariance[:2, :2] @ turn.T
        values, vectors = np.linalg.eigh(ellipse)
        most = MOST_DRIFT * self._config.key_nodes.trajectory_length_m
        long_axis = vectors[:, 1]
        half_length = min(3.0 * float(np.sqrt(values[1])), most)
        length = float(np.hypot(predicted[0], predicted[1]))
        along = np.arange(0.0, length, loops.guess_every_m)[:, None] * (-predicted[:2] / max(length, 1e-9))
        axis = np.arange(-half_length, half_length, loops.guess_every_m)[:, None] * long_axis
        steps = np.concatenate((np.zeros((1, 2)), along, axis))
        inside = np.einsum("ni,ij,nj->n", steps, np.linalg.inv(ellipse), steps) <= 9.0
        radius = float(np.clip(3.0 * np.sqrt(values[0]), self._config.match.reach_m, most))
        angle = float(np.clip(3.0 * np.sqrt(covariance[2, 2]), 0.05, loops.most_turn_rad))
        guesses = predicted[:2] + steps[inside]
        return Region(predicted, guesses, radius, angle, loops.tie_weight, half_length + radius, angle)

    def _recent_points(self) -> Float:
        """The points of the last T_l of trajectory in the frame of the newest node."""
        length_m = self._config.key_nodes.trajectory_length_m
        return recent_points(self._chains, self._graph.points, length_m, self._chains.last)
