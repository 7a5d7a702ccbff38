"""The first pass of a rebuild: edges between successive nodes, matched again behind the rebuilt trail. IGO IV-C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.front_end.builder import FrontEnd
from mapmend.front_end.edge_covariance import edge_covariance
from mapmend.front_end.motion import odometry_covariance, odometry_std
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo.fits import Fits
from mapmend.igo.guesses import between, is_between, is_same
from mapmend.igo.observed import Bool, Float, Measured, NewEdge, Observer, runs, turned
from mapmend.igo.steady import SteadyMotion, steady_motion, usual_change
from mapmend.igo.trail import TrailGrid
from mapmend.igo.wheels import Slips
from mapmend.matching.gauss_newton import UNSEEN_STD_M, Match, round_prior
from mapmend.parallel import Progress, no_progress

# How many edges back the speed of an edge is learnt from.
LOOK_BACK = 40
# Edges after an open one may be biased too: what comes into sight was drawn at poses that the open ones carried off.
AFTER_OPEN = 10
# A shorter open stretch is one only if the steady speed makes its length another by so many standard deviations: over
# a few edges the front end's own prior is as good, and what looks open there is a corner seen by few beams. Lengths of
# 2 to 3 m and 3 to 5 deviations do nearly the same (`benchmarks/lasers.py`, `corridor.py`, on seeds not shown there).
LONG_OPEN_M, OPEN_SIGMA = 3.0, 5.0
# An edge that has an open axis is unchanged that moves by less: its motion is not matched but computed, and does not
# scatter.
SAME_OPEN = 0.002
# An edge is biased that its re-match leaves by more than this, in squared standard deviations times what is usual: the
# 99.9 % quantile of chi-square with three degrees of freedom; its median; and over how many edges the usual is taken.
FAR_CHI2, MEDIAN_CHI2, SCATTER_OVER = 16.27, 2.37, 100
# A match is doubtful that fits less well than the usual one, or lies so many standard deviations off the odometry. A
# node's share of the usual fit makes it follow some twenty nodes.
CONTRADICTS, USUAL_SHARE = 2.0, 0.05
# Fits closer than so many standard deviations are ties: neighbouring beams err together, so three and not two. A match
# that fits better by the gain, a share of the beams, needs no other word for it.
TIE, CLEAR_GAIN = 3.0, 0.05
# A covariance is told to the graph that is below this share of the old one, by determinants.
SURER = 0.5


@dataclass(frozen=True)
class Places:
    """Where a node may be, poses (3,): the node ``behind`` it, and this one by odometry, by its edge, by the optimizer.

    ``motion`` (3,): what is expected of the edge, with its ``std``: translation [m] and rotation [rad].
    """

    behind: Float
    motion: Float
    std: tuple[float, float]
    predicted: Float
    old: Float
    guess: Float


@dataclass(frozen=True)
class OdometryResult:
    """``edges``: the new ones, by the node that they end at. ``poses`` (n, 3): the rebuilt map's. ``matched``, and how
    many of these ``changed``, before score and covariance had their say. ``unsettled`` (n,): those to match again."""

    edges: dict[int, NewEdge]
    poses: Float
    matched: int
    changed: int
    unsettled: Bool


class OdometryPass:
    """Lines 4 to 14 of Algorithm 1."""

    def __init__(self, front_end: FrontEnd) -> None:
        self._front_end = front_end
        self._state, self._points, self._matcher = front_end.state, front_end.points, front_end.matcher
        self._config = front_end.config
        self._observer = Observer(front_end.config)
        self._seconds = edge_seconds(front_end)
        self._measured = Measured.of_nothing(front_end.state.count)
        self._steady: SteadyMotion | None = None
        self._change = np.zeros(3)
        self._fits = Fits(front_end.config)
        self._usual_fit = 1.0
        self._slips = Slips(front_end.state, front_end.config)
        self._scatter = np.zeros(front_end.state.count)

    def run(self, wanted: Bool, progress: Progress = no_progress) -> OdometryResult:
        """Matches the ``wanted`` edges (n,) again, each by the node that it ends at."""
        state, n = self._state, self._state.count
        trail = TrailGrid(state, self._points, self._config)
        optimized = state.node_pose[:n].copy()
        poses = optimized.copy()
        accepted, differs = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        for j in range(1, n):
            step = se2.between(optimized[j - 1], optimized[j])
            if wanted[j]:
                step, differs[j], accepted[j] = self._rematch(j, poses[j - 1], step, trail.before(j, poses))
            poses[j] = se2.compose(poses[j - 1], step)
            if j % 100 == 99 or j == n - 1:
                progress("rebuilding", j + 1, n)
        edges = self._new_edges(wanted, accepted, optimized)
        for j in range(1, n):
            step = edges[j].motion if j in edges else se2.between(optimized[j - 1], optimized[j])
            poses[j] = se2.compose(poses[j - 1], step)
        replaced = np.isin(np.arange(n), list(edges))
        # The errors of neighbouring edges cancel: what lies beside a replaced one, and differed, is asked once more.
        beside = np.zeros(n, dtype=np.bool_)
        beside[1:] |= replaced[:-1]
        beside[:-1] |= replaced[1:]
        changed = max(int(differs.sum()), len(edges))
        return OdometryResult(edges, poses, int(wanted[1:].sum()), changed, replaced | (differs & beside))

    def _rematch(self, j: int, behind: Float, step: Float, grid: SurfaceGrid) -> tuple[Float, bool, bool]:
        """Matches node j on the grid of those before it: the step to take, whether it differs, and is accepted.

        Guesses lie every few centimetres between where the edge puts the node and where the optimizer does.
        """
        state, m = self._state, self._measured
        points = self._points.of(int(state.node_scan[j]))
        motion = self._expected_motion(j, step)
        predicted, old, guess = (se2.compose(behind, one) for one in (motion, state.odometry_edge[j], step))
        places = Places(behind, motion, odometry_std(motion, self._config.motion), predicted, old, guess)
        match = self._best(grid, points, places)
        information, axis = self._observer.information(grid, points, match)
        found = se2.between(behind, match.pose)
        if axis.any():
            axis, found = self._held_by_odometry(grid, points, match, places, axis)
        m.motions[j], m.information[j], m.open_axes[j] = found, information, axis
        m.covariances[j], m.scores[j] = match.covariance(), match.score
        if self._is_by_laser_alone and m.open_axes[max(1, j - AFTER_OPEN) : j + 1].any():
            return self._steady_step(j), True, False
        differs = self._differs(j, found)
        accepted = differs and not axis.any() and self._is_accepted(j, grid, points, match, places)
        return (found if accepted else step), differs, accepted

    def _held_by_odometry(
        self, grid: SurfaceGrid, points: Float, match: Match, places: Places, axis: Float
    ) -> tuple[Float, Float]:
        """An open axis (2,) and the motion (3,) of a match with the odometry's part along it.

        Where the scan fits worse there, the axis was not open, and the match stands.
        """
        found = se2.between(places.behind, match.pose)
        along, held = turned(axis, found[2]), found.copy()
        held[:2] += along * float(along @ (places.motion[:2] - found[:2]))
        gain, noise = self._fits.gain(grid, points, match.pose, se2.compose(places.behind, held))
        return (np.zeros(2), found) if gain > max(TIE * noise, CLEAR_GAIN) else (axis, held)

    def _differs(self, j: int, found: Float) -> bool:
        """Whether a re-match differs from the edge; notes by how much, in squared standard deviations of the edge."""
        off = se2.between(self._state.odometry_edge[j], found)
        self._scatter[j] = float(off @ np.linalg.solve(self._state.odometry_covariance[j], off))
        return not is_same(self._state.odometry_edge[j], found)

    def _is_beyond_scatter(self, j: int) -> bool:
        """Whether edge j came back farther off than edges of this log, and near here, do.

        Among leaves, matches of one scan on two grids differ by more than they say. The usual squared Mahalanobis
        distance of the last edges is the measure.
        """
        before = self._scatter[max(1, j - SCATTER_OVER) : j + 1]
        usual = max(float(np.median(before)) / MEDIAN_CHI2, 1.0)
        return bool(self._scatter[j] > FAR_CHI2 * usual)

    @property
    def _is_by_laser_alone(self) -> bool:
        return not self._config.motion.use_odometry

    def _expected_motion(self, j: int, step: Float) -> Float:
        """What the odometry reports of edge j; without odometry, the step of now."""
        if self._is_by_laser_alone:
            return step if self._steady is None else self._steady.motions[j - 1]
        odometry, scans = self._front_end.log.odometry, self._state.node_scan
        return se2.between(odometry[scans[j - 1]], odometry[scans[j]])

    def _best(self, grid: SurfaceGrid, points: Float, places: Places) -> Match:
        """The best-fitting match from guesses between poses; fits that tie go to the pose nearest the optimizer's.

        Where the first match fits less well than usual or contradicts the odometry, wheels may have slipped: part of
        the motion did not happen, and guesses lie also between no motion and what the odometry reports.
        """
        behind, predicted, guess, std = places.behind, places.predicted, places.guess, places.std
        best = self._matcher.match(grid, points, guess, round_prior(predicted, *std))
        off = se2.between(predicted, best.pose)
        fit = self._fits.fit(grid, points, best.pose)
        doubtful = fit < self._usual_fit or np.hypot(off[0], off[1]) > CONTRADICTS * std[0]
        others = between(places.old, guess, self._config.loops.guess_every_m)
        if doubtful and not self._is_by_laser_alone:
            others += [predicted, behind, *between(behind, predicted, self._config.loops.guess_every_m)]
        for start in others:
            other = self._matcher.match(grid, points, start, round_prior(start if doubtful else predicted, *std))
            is_possible = not doubtful or is_between(behind, predicted, other.pose, 3.0 * std[0])
            gain, noise = self._fits.gain(grid, points, other.pose, best.pose) if is_possible else (0.0, 1.0)
            if gain > noise:
                best, fit = other, self._fits.fit(grid, points, other.pose)
        self._usual_fit += USUAL_SHARE * (fit - self._usual_fit)
        return best

    def _doubt(self, pose: Float, places: Places) -> float:
        """What a pose must fit ahead of the edge's for being farther from the odometry than that, up to its weight.

        Nothing, where the optimizer sides with the new pose, and where wheels that slipped explain it: it falls short
        of what they report, by more than they usually err. Wheels never report too little.
        """
        predicted, old, guess, std = places.predicted, places.old, places.guess, places.std
        if np.hypot(*(pose - guess)[:2]) < np.hypot(*(old - guess)[:2]):
            return 0.0
        off, off_before = se2.between(predicted, pose), se2.between(predicted, old)
        falls_short = turned(places.motion[:2], -places.motion[2]) @ off[:2] < 0.0
        if falls_short and np.hypot(off[0], off[1]) > CONTRADICTS * std[0]:
            return 0.0
        new, before = (
            min(((o[0] ** 2 + o[1] ** 2) / std[0] ** 2 + (o[2] / std[1]) ** 2) / 9.0, 1.0) for o in (off, off_before)
        )
        return self._config.motion.prior_weight * max(new - before, 0.0)

    def _is_accepted(self, j: int, grid: SurfaceGrid, points: Float, match: Match, places: Places) -> bool:
        """Whether a match replaces the edge that it differs from: by fit, where fits tie by the optimizer.

        A difference within what edges of this log scatter is none, unless the fit says otherwise by far. A poor score
        will do where wheels slipped: there the old edge is no better known, and the covariance says how poor it is.
        """
        old, guess = places.old, places.guess
        is_good = match.score >= self._config.match.min_score
        if not is_good and not self._is_slip(places.motion, se2.between(places.behind, match.pose)):
            return False
        gain, noise = self._fits.gain(grid, points, match.pose, old)
        gain -= self._doubt(match.pose, places)
        if gain > max(TIE * noise, CLEAR_GAIN):
            return True
        if not is_good or not self._is_beyond_scatter(j):
            return False
        nearer = np.hypot(*(match.pose - guess)[:2]) < 0.5 * np.hypot(*(old - guess)[:2])
        return bool(gain > TIE * noise or (gain >= -TIE * noise and nearer))

    def _steady_step(self, j: int) -> Float:
        """The motion of edge j at a steady speed: from the round before, or from what lies behind."""
        if self._steady is not None:
            return self._steady.motions[j - 1]
        m, seconds = self._measured, self._seconds
        if not self._change.any() or j % LOOK_BACK == 0:
            self._change = usual_change(m.motions[1:j], m.information[1:j], seconds[1:j])
        rows = np.arange(max(1, j - LOOK_BACK), j + 1)
        return steady_motion(m.motions[rows], m.information[rows], seconds[rows], self._change).motions[-1]

    def _new_edges(self, wanted: Bool, accepted: Bool, optimized: Float) -> dict[int, NewEdge]:
        """The edges to replace, with their covariances by IGO (2)."""
        expected = self._expected_motions()
        happened = self._happened(expected)
        odometry = np.array([odometry_covariance(step, self._config.motion) for step in happened])
        slipped: dict[int, NewEdge] = {}
        if self._is_by_laser_alone:
            accepted = accepted | self._level_speeds(wanted, odometry)
        else:
            slipped = self._slips.find(self._measured, expected, optimized, odometry)
        matched = {int(j): self._new_edge(int(j), odometry[j]) for j in np.flatnonzero(accepted)}
        rows = np.flatnonzero(wanted & ~accepted & (happened != expected).any(axis=1))
        return {**{j: new for j, new in slipped.items() if wanted[j]}, **self._surer(rows, odometry), **matched}

    def _happened(self, expected: Float) -> Float:
        """The motions (n, 3) that Sigma_odo is taken of: the reported ones, but where wheels slipped the matched ones.

        A spin of two metres makes the model as unsure as a drive of two metres. Where the scan was found to have moved
        less, by more than the wheels err over what it did move, that says nothing of the edge.
        """
        happened = expected.copy()
        if self._is_by_laser_alone:
            return happened
        for j in np.flatnonzero(self._measured.scores > 0.0):
            if self._is_slip(expected[j], self._measured.motions[j]):
                happened[j] = self._measured.motions[j]
        return happened

    def _is_slip(self, reported: Float, found: Float) -> bool:
        """Whether a motion (3,) falls short of the reported one by more than wheels err over a motion like it.

        By one standard deviation: with a model as wide as the paper's, two would excuse nearly every slip.
        """
        way, off = (float(np.hypot(step[0], step[1])) for step in (found, reported - found))
        std, _ = odometry_std(found, self._config.motion)
        return way < np.hypot(reported[0], reported[1]) and off > std

    def _surer(self, rows: NDArray[np.int64], odometry: Float) -> dict[int, NewEdge]:
        """Edges over slips that came back unchanged, and surer than the slip had left them."""
        state, surer = self._state, {}
        for j in (int(row) for row in rows):
            new = self._new_edge(j, odometry[j])
            is_surer = np.linalg.det(new.covariance) < SURER * np.linalg.det(state.odometry_covariance[j])
            if is_surer and is_same(state.odometry_edge[j], new.motion):
                surer[j] = NewEdge(state.odometry_edge[j].copy(), new.covariance, new.drift)
        return surer

    def _new_edge(self, j: int, odometry: Float) -> NewEdge:
        m = self._measured
        motion = m.motions[j]
        carry = se2.adjoint(se2.inverse(motion))
        before = m.covariances[j - 1] if m.scores[j - 1] else m.covariances[j]
        both = m.covariances[j] + carry @ before @ carry.T
        if m.is_open[j]:
            both = opened(both, m.open_axes[j])
        return NewEdge(motion, *edge_covariance(both, odometry, m.scores[j], self._config.match.min_score))

    def _level_speeds(self, wanted: Bool, odometry: Float) -> Bool:
        """Gives the open edges a steady speed, from both ends of each stretch; which edges that changes.

        ``odometry`` (n, 3, 3): Sigma_odo; written where the speed says more.
        """
        m, n = self._measured, self._state.count
        if not m.is_open.any():
            return np.zeros(n, dtype=np.bool_)
        self._change = usual_change(m.motions[1:], m.information[1:], self._seconds[1:])
        self._steady = steady_motion(m.motions[1:], m.information[1:], self._seconds[1:], self._change)
        self._close_what_is_as_before()
        after = np.zeros(n, dtype=np.bool_)
        for j in np.flatnonzero(m.is_open):
            along = turned(m.open_axes[j], m.motions[j, 2])
            m.motions[j, :2] += along * float(along @ (self._steady.motions[j - 1, :2] - m.motions[j, :2]))
            after[j : j + AFTER_OPEN + 1] = True
        for first, end in runs(m.is_open):
            share = self._seconds[first:end] / self._seconds[first:end].sum()
            odometry[first:end] = share[:, None, None] * self._steady.covariance_of_sum(first - 1, end - 1)
        return self._unlike_before(after & wanted)

    def _close_what_is_as_before(self) -> None:
        """Takes short open stretches for none where the edges had the length that the steady speed gives."""
        m, steady, before = self._measured, self._steady, self._state.odometry_edge
        assert steady is not None
        for first, end in runs(m.is_open):
            length, off, ahead = 0.0, np.zeros(2), np.zeros(2)
            for j in range(first, end):
                motion = steady.motions[j - 1, :2]
                along = turned(m.open_axes[j], m.motions[j, 2])
                along *= np.copysign(1.0, along @ motion)
                off += along * float(along @ (motion - before[j, :2]))
                ahead += along
                length += float(np.hypot(motion[0], motion[1]))
            ahead /= max(float(np.hypot(ahead[0], ahead[1])), 1e-9)
            variance = ahead @ steady.covariance_of_sum(first - 1, end - 1)[:2, :2] @ ahead
            if length < LONG_OPEN_M and float(ahead @ off) ** 2 <= OPEN_SIGMA**2 * variance:
                m.open_axes[first:end] = 0.0

    def _unlike_before(self, rows: Bool) -> Bool:
        """Which of the edges have another measurement than in the graph."""
        unlike = rows.copy()
        for j in np.flatnonzero(rows):
            off = se2.between(self._state.odometry_edge[j], self._measured.motions[j])
            unlike[j] = max(np.hypot(off[0], off[1]), abs(off[2])) > SAME_OPEN
        return unlike

    def _expected_motions(self) -> Float:
        if self._is_by_laser_alone:
            return self._measured.motions
        poses = self._front_end.log.odometry[self._state.node_scan[: self._state.count]]
        return np.concatenate((np.zeros((1, 3)), se2.between(poses[:-1], poses[1:])))


def edge_seconds(front_end: FrontEnd) -> Float:
    """How long each odometry edge took, (n,), by the node that it ends at; by its number of scans where stamps jump."""
    scans, stamps = front_end.state.node_scan[: front_end.state.count], front_end.log.stamps_s
    interval = np.diff(stamps)
    usual = float(np.median(interval[interval > 0.0])) if (interval > 0.0).any() else 1.0
    by_count = usual * np.maximum(np.diff(scans, prepend=0), 1)
    seconds = np.diff(stamps[scans], prepend=stamps[0])
    return np.where((seconds > 0.2 * by_count) & (seconds < 5.0 * by_count), seconds, by_count)


def opened(covariance: Float, axis: Float) -> Float:
    """A covariance (3, 3) that leaves an axis (2,) open."""
    wide = covariance.copy()
    wide[:2, :2] += UNSEEN_STD_M**2 * np.outer(axis, axis)
    return wide
