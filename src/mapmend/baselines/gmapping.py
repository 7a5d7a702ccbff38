"""A Rao-Blackwellized particle filter on grid maps: Grisetti, Stachniss and Burgard (2007). IGO compares with it.

Every particle carries a path and its own map. At an update, each matches the scan on its map, fits a Gaussian to
observation and odometry about the match, draws its new pose from it and is weighed by the mass under it. Particles
are resampled only when their weights say that few are left that matter. Equations are those of the paper, "Improved
Techniques for Grid Mapping with Rao-Blackwellized Particle Filters", IEEE Transactions on Robotics 23(1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.baselines._filter_kernels import Likelihood, Particles, ProposalSettings, propose
from mapmend.baselines.follower import Follower, motion_std, size_of
from mapmend.baselines.particle_maps import ParticleMaps
from mapmend.config import Config, GMappingConfig
from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.matching.gauss_newton import match_settings
from mapmend.parallel import Progress, map_in_order, no_progress
from mapmend.scan import ScanLog
from mapmend.scan_graph.chains import OdometryEdge
from mapmend.scan_graph.points import ScanPoints
from mapmend.scan_graph.scan_graph import ScanGraph

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Particles that one thread moves at a time: their kernels' calls cost as little as their work is long.
CHUNK = 4


@dataclass(frozen=True)
class Update:
    """One scan that went into the maps.

    ``tracked`` (3,): the motion since the update before, as the scans between had it. ``poses`` (particles, 3),
    ``covariances`` (particles, 3, 3) of the proposals in the map's axes, ``parents`` (particles,): whose path, up to
    the update before, each goes on with.
    """

    scan: int
    tracked: Float
    poses: Float
    covariances: Float
    parents: Int


class ParticleFilter:
    """Goes through a log once; `updates` then holds every particle's poses, and who descends from whom."""

    def __init__(self, log: ScanLog, config: Config, threads: int = 1, progress: Progress = no_progress) -> None:
        self.log = log
        self.config = config
        self.settings: GMappingConfig = config.gmapping
        self._threads = threads
        self._progress = progress
        self._points = ScanPoints(log.scans, config.scan)
        self._random = np.random.default_rng(config.seed)
        count = self.settings.particles
        self.maps = ParticleMaps(count, config.grid.cell_size_m)
        self.poses = np.zeros((count, 3))
        self.log_weights = np.zeros(count)
        self.updates: list[Update] = []
        self.resamplings = 0
        self.unmatched = 0
        self._parents = np.arange(count)
        self._best = 0
        self.follower = Follower(log, config, self._random)
        self._match_settings = match_settings(config.match, is_roughness_used=False)
        # Since the last update: way and turn, the believed motion with the variance of its unknown part, and the motion
        # by the scans.
        self._way_m = self._turn_rad = 0.0
        self._believed = np.zeros(3)
        self._unknown = np.zeros(2)
        self._tracked = np.zeros(3)
        # Every scan's place, seen from the last update's scan.
        self.T_update_scan = np.zeros((len(log), 3))
        self.scan_update = np.zeros(len(log), dtype=np.int64)

    def run(self) -> None:
        """Filters the whole log."""
        total = len(self.log)
        for k in range(total):
            self._take_scan(k)
            if k % 100 == 99 or k == total - 1:
                self._progress("filtering", k + 1, total)

    def _take_scan(self, k: int) -> None:
        """Follows the robot to scan k, and updates the particles where it went far enough."""
        points = self._points.of(k)
        if k == 0:
            self._insert(k, points, np.zeros((len(self.poses), 3, 3)))
            return
        origin = self.poses[self._best]
        before = se2.compose(origin, self._tracked)
        step = self.follower.follow(k, self.maps.of(self._best), points, before)
        way_m, turn_rad = size_of(step.believed)
        self._way_m += way_m
        self._turn_rad += turn_rad
        self._believed = se2.compose(self._believed, step.believed)
        self._unknown += step.unknown
        self._tracked = se2.compose(self._tracked, step.tracked)
        self.T_update_scan[k] = self._tracked
        self.scan_update[k] = len(self.updates) - 1
        settings = self.settings
        if self._way_m >= settings.linear_update_m or self._turn_rad >= settings.angular_update_rad:
            self._update(k, points)

    def _update(self, k: int, points: Float) -> None:
        """Steps 1 to 6 of the paper's Algorithm 1 for all particles, then its selective resampling."""
        count = len(self.poses)
        poses = se2.compose(self.poses, self._tracked)
        particles = Particles(poses, np.zeros(count), np.zeros((count, 3, 3)), np.zeros(count))
        std = np.sqrt(np.square(motion_std(self._way_m, self._turn_rad, self.settings)) + self._unknown)
        expected = self._believed if self.config.motion.use_odometry else self._tracked
        priors = np.column_stack((se2.compose(self.poses, expected), np.tile(std, (count, 1))))
        normals = self._random.standard_normal((count, 3))
        likelihood = Likelihood(float(self.settings.lsigma_m), float(self.config.match.reach_m))
        settings = ProposalSettings(float(self.settings.minimum_score), self._match_settings, likelihood)

        def move(first: int) -> None:
            rows = slice(first, first + CHUNK)
            own = Particles(*(array[rows] for array in particles))
            propose(self.maps.shared, first, points, own, priors[rows], settings, normals[rows])

        map_in_order(move, range(0, count, CHUNK), self._threads)
        self.poses = particles.poses
        self.unmatched += int(np.count_nonzero(particles.scores < self.settings.minimum_score))
        self.log_weights += particles.log_weights / self.settings.ogain
        self.log_weights -= self.log_weights.max()
        self._insert(k, points, particles.covariances)
        self._best = int(np.argmax(self.log_weights))
        self._resample()

    def _insert(self, k: int, points: Float, covariances: Float) -> None:
        """Puts scan k into every particle's map at its pose, and notes the update."""
        laser = self._points.laser_origin(k)
        self.maps.claim(points, laser, self.poses)

        def insert(first: int) -> None:
            for p in range(first, min(first + CHUNK, len(self.poses))):
                self.maps.insert(p, points, laser, self.poses[p])

        map_in_order(insert, range(0, len(self.poses), CHUNK), self._threads)
        self.updates.append(Update(k, self._tracked, self.poses.copy(), covariances, self._parents))
        self._parents = np.arange(len(self.poses))
        self._way_m = self._turn_rad = 0.0
        self._believed, self._unknown, self._tracked = np.zeros(3), np.zeros(2), np.zeros(3)
        self.T_update_scan[k] = 0.0
        self.scan_update[k] = len(self.updates) - 1

    def _resample(self) -> None:
        """Selective resampling: only where the effective sample size, eq. (20), falls below its share of all."""
        weights = np.exp(self.log_weights)
        weights /= weights.sum()
        effective = 1.0 / float(np.square(weights).sum())
        if effective >= self.settings.resample_threshold * len(weights):
            return
        self._parents = systematic(weights, float(self._random.random()))
        # The heaviest has an heir: nobody weighs more than 1 / n unless somebody else weighs less.
        self._best = int(np.searchsorted(self._parents, self._best))
        self.poses = self.poses[self._parents]
        self.maps.resample(self._parents)
        self.log_weights = np.zeros(len(weights))
        self.resamplings += 1

    def best_path(self) -> tuple[Float, Float]:
        """Poses (updates, 3) and covariances (updates, 3, 3) of the best particle and its ancestors."""
        poses, covariances = np.empty((len(self.updates), 3)), np.empty((len(self.updates), 3, 3))
        p = int(self._parents[self._best])
        for row in range(len(self.updates) - 1, -1, -1):
            update = self.updates[row]
            poses[row], covariances[row] = update.poses[p], update.covariances[p]
            p = int(update.parents[p])
        # A match near half a turn may end beyond it; the poses of the scans are all within [-pi, pi).
        poses[:, 2] = se2.wrap_angle(poses[:, 2])
        return poses, covariances


def systematic(weights: Float, shift: float) -> Int:
    """Who is drawn, shape (n,): n even steps through the weights, the first at ``shift`` (0 to 1) of a step."""
    n = len(weights)
    ends = np.cumsum(weights)
    return np.minimum(np.searchsorted(ends, (shift + np.arange(n)) / n * ends[-1], side="right"), n - 1)


def path_graph(particle_filter: ParticleFilter) -> tuple[PoseGraph, Float]:
    """The best particle's path as a chain of nodes with scans, and the poses (n, 3) of all scans of the log.

    A scan between two updates follows both: what the second changed of the step that the scans had reported up to it
    is shared out along the way.
    """
    log, updates = particle_filter.log, particle_filter.updates
    poses, covariances = particle_filter.best_path()
    graph = ScanGraph(particle_filter.config, log.scans.geometries)
    before = np.zeros((3, 3))
    rows = {update.scan: row for row, update in enumerate(updates)}
    for k, update_row in enumerate(particle_filter.scan_update.tolist()):
        if k in rows:
            row = rows[k]
            cos, sin = math.cos(poses[row, 2]), math.sin(poses[row, 2])
            turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
            own = turn @ covariances[row] @ turn.T
            edge = None
            if row:
                step = se2.between(poses[row - 1], poses[row])
                carry = se2.adjoint(se2.inverse(step))
                covariance = own + carry @ before @ carry.T
                edge = OdometryEdge(step, covariance, covariance)
            # The steps between the nodes as the scans between them were tracked: what their places are relative to.
            graph.add_node(log.scans.ranges_of(k), log.scans.laser_of(k), poses[row], edge, updates[row].tracked)
            before = own
        graph.hung.hang(float(log.stamps_s[k]), log.odometry[k], update_row, particle_filter.T_update_scan[k])
    return graph.pose_graph(with_scans=True), graph.scan_poses()
