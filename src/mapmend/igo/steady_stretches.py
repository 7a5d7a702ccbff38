"""By laser alone, open edges get the motion of a steady speed, from both ends of each open stretch."""

from __future__ import annotations

import numpy as np

from mapmend.geometry import se2
from mapmend.igo.observed import Bool, Float, MatchedEdges, runs, turned
from mapmend.igo.steady import SteadyMotion, steady_motion, usual_change
from mapmend.scan_graph.hung_scans import HungScans
from mapmend.scan_graph.scan_graph import ScanGraph

# How much the speed changes is estimated anew every this many edges; in between it hardly changes.
LEARN_EVERY = 40
# A stretch shorter than `igo.long_open_m` counts only if the steady speed changes its length by this many standard
# deviations: over a few edges the front end's own prior is as good, and a stretch that looks open may be a corner seen
# by few beams. Lengths of 2 to 3 m and 3 to 5 deviations do nearly the same (`benchmarks/lasers.py`, `corridor.py`, on
# seeds not shown there).
OPEN_SIGMA = 5.0
# An edge with an open axis is unchanged if it moves by less: its motion is computed and not matched, so that it has no
# scatter.
SAME_OPEN = 0.002


class SteadyStretches:
    """The steady speed of a log, round after round, from the matches of its edges, ``matched``."""

    def __init__(self, graph: ScanGraph, matched: MatchedEdges) -> None:
        self._settings = graph.config.igo
        self._chains = graph.chains
        self._matched = matched
        self._seconds = edge_seconds(graph.hung)
        self._steady: SteadyMotion | None = None
        self._change = np.zeros(3)

    def expected(self, j: int, step: Float) -> Float:
        """The expected motion of edge j before it is matched: the speed of the round before, or the current
        ``step``."""
        return step if self._steady is None else self._steady.motions[j - 1]

    def may_be_biased(self, j: int) -> bool:
        """Whether edge j, or one of those just before it, is open."""
        first, _ = self._chains.within(j, self._settings.after_open_m, 0.0)
        return bool(self._matched.open_axes[first : j + 1].any())

    def step(self, j: int) -> Float:
        """The motion of edge j at a steady speed: from the round before, or from the edges before it."""
        if self._steady is not None:
            return self._steady.motions[j - 1]
        matched, seconds = self._matched, self._seconds
        if not self._change.any() or j % LEARN_EVERY == 0:
            self._change = usual_change(matched.motions[1:j], matched.information[1:j], seconds[1:j])
        first, _ = self._chains.within(j, self._settings.speed_from_m, 0.0)
        rows = np.arange(max(first, 1), j + 1)
        return steady_motion(matched.motions[rows], matched.information[rows], seconds[rows], self._change).motions[-1]

    def level_speeds(self, wanted: Bool, odometry: Float) -> Bool:
        """Gives the open edges a steady speed, from both ends of each stretch; returns which edges this changes.

        ``odometry`` (n, 3, 3): Sigma_odo; overwritten for the open edges by the covariance of the speed.
        """
        matched, n = self._matched, len(self._chains)
        if not matched.is_open.any():
            return np.zeros(n, dtype=np.bool_)
        self._change = usual_change(matched.motions[1:], matched.information[1:], self._seconds[1:])
        self._steady = steady_motion(matched.motions[1:], matched.information[1:], self._seconds[1:], self._change)
        self._close_what_is_as_before(self._steady)
        after = np.zeros(n, dtype=np.bool_)
        for j in np.flatnonzero(matched.is_open):
            along = turned(matched.open_axes[j], matched.motions[j, 2])
            off = self._steady.motions[j - 1, :2] - matched.motions[j, :2]
            matched.motions[j, :2] += along * float(along @ off)
            after[j : self._chains.within(int(j), 0.0, self._settings.after_open_m)[1]] = True
        for first, end in runs(matched.is_open):
            share = self._seconds[first:end] / self._seconds[first:end].sum()
            odometry[first:end] = share[:, None, None] * self._steady.covariance_of_sum(first - 1, end - 1)
        return self._unlike_before(after & wanted)

    def _close_what_is_as_before(self, steady: SteadyMotion) -> None:
        """Treats short open stretches as not open if their edges had the length that the steady speed gives."""
        matched, before = self._matched, self._chains.edges
        for first, end in runs(matched.is_open):
            length, off, ahead = 0.0, np.zeros(2), np.zeros(2)
            for j in range(first, end):
                motion = steady.motions[j - 1, :2]
                along = turned(matched.open_axes[j], matched.motions[j, 2])
                along *= np.copysign(1.0, along @ motion)
                off += along * float(along @ (motion - before[j, :2]))
                ahead += along
                length += float(np.hypot(motion[0], motion[1]))
            ahead /= max(float(np.hypot(ahead[0], ahead[1])), 1e-9)
            variance = ahead @ steady.covariance_of_sum(first - 1, end - 1)[:2, :2] @ ahead
            if length < self._settings.long_open_m and float(ahead @ off) ** 2 <= OPEN_SIGMA**2 * variance:
                matched.open_axes[first:end] = 0.0

    def _unlike_before(self, rows: Bool) -> Bool:
        """Which of the edges have another measurement than in the graph."""
        unlike = rows.copy()
        for j in np.flatnonzero(rows):
            off = se2.between(self._chains.edges[j], self._matched.motions[j])
            unlike[j] = max(np.hypot(off[0], off[1]), abs(off[2])) > SAME_OPEN
        return unlike


def edge_seconds(hung: HungScans) -> Float:
    """The duration of each odometry edge, (n,), by its last node; from its number of scans where stamps jump."""
    scans, stamps = hung.node_scan, hung.stamps_s
    interval = np.diff(stamps)
    usual = float(np.median(interval[interval > 0.0])) if (interval > 0.0).any() else 1.0
    by_count = usual * np.maximum(np.diff(scans, prepend=0), 1)
    seconds = np.diff(stamps[scans], prepend=stamps[0])
    return np.where((seconds > 0.2 * by_count) & (seconds < 5.0 * by_count), seconds, by_count)
