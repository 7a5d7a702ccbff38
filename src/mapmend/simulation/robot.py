"""A robot with a laser and slipping wheels drives through a building: a log, and the truth about it.

All random numbers follow from one seed. Slips, odometry, range noise and lost returns each have a stream of their own,
so that a change of one does not change the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array, between, compose, wrap_angle
from mapmend.scan import LaserGeometry, ScanLog, Scans
from mapmend.simulation.drive import SlipEvent, plan_drive, straight_stretches
from mapmend.simulation.ray_casting import cast_rays
from mapmend.simulation.world import World

HALF_CIRCLE_LASER = LaserGeometry(180, -np.pi / 2.0, np.pi / 180.0, 8.0)
"""180 beams, one a degree from right to left, 8 m: common when the public logs were recorded."""

SHORTEST_RANGE_M = 1e-3
"""Noise never makes a reading shorter than this: a range is positive."""

GAP_BETWEEN_SLIPS_M = 0.5

SPEED_WANDERS_S = 3.0
"""The time after which a wandering speed has forgotten its deviation by a factor of e."""

SLOWEST_SHARE = 0.2
"""A wandering speed never falls below this share of the speed."""


@dataclass(frozen=True)
class LaserModel:
    """A laser and its faults. Readings are noisy, then rounded to steps (0: not at all), then some are lost.

    A lost return, and one that noise carries to ``geometry.max_range_m`` or beyond, reads ``inf``.
    """

    geometry: LaserGeometry = HALF_CIRCLE_LASER
    range_noise_std_m: float = 0.01
    quantization_m: float = 0.0
    lost_share: float = 0.0

    def __post_init__(self) -> None:
        if not (self.range_noise_std_m >= 0.0 and self.quantization_m >= 0.0 and 0.0 <= self.lost_share <= 1.0):
            raise MapmendError(f"a laser's noise and steps must not be negative, its lost_share in [0, 1]; got {self}")


@dataclass(frozen=True)
class OdometryModel:
    """The motion that the wheels report, as a function of the true motion.

    Noise is a random walk: the standard deviation is the given one after 1 m or 1 rad of motion and grows with the root
    of the motion, independent of the time between scans. ``translation_scale`` and ``rotation_scale`` multiply the
    motion, and ``rotation_bias_radpm`` turns the robot while it drives. ``slips`` are at the given places;
    ``random_slip_count`` more are at random places on straight stretches, with a length and a share drawn from the two
    intervals.
    """

    forward_std_m_after_1_m: float = 0.02
    forward_std_m_after_1_rad: float = 0.01
    sideways_std_m_after_1_m: float = 0.005
    rotation_std_rad_after_1_m: float = 0.01
    rotation_std_rad_after_1_rad: float = 0.03
    translation_scale: float = 1.0
    rotation_scale: float = 1.0
    rotation_bias_radpm: float = 0.0
    slips: tuple[SlipEvent, ...] = ()
    random_slip_count: int = 0
    random_slip_length_m: tuple[float, float] = (1.0, 3.0)
    random_slip_share: tuple[float, float] = (0.2, 0.6)

    def __post_init__(self) -> None:
        noise = (
            self.forward_std_m_after_1_m,
            self.forward_std_m_after_1_rad,
            self.sideways_std_m_after_1_m,
            self.rotation_std_rad_after_1_m,
            self.rotation_std_rad_after_1_rad,
        )
        if not all(0.0 <= std < np.inf for std in noise) or self.random_slip_count < 0:
            raise MapmendError(f"an odometry's noise and its number of slips must not be negative, got {self}")

    @staticmethod
    def exact(slips: tuple[SlipEvent, ...] = ()) -> OdometryModel:
        """Wheels without noise, which slip only at the given places."""
        return OdometryModel(0.0, 0.0, 0.0, 0.0, 0.0, slips=slips)


@dataclass(frozen=True)
class Simulation:
    """A log and what really happened. ``truth``: shape (n, 3), the robot's poses in the world at each scan.

    ``path_m``: shape (n,), the path on the ground up to each scan. ``slips``: all of them, in the order of the route.
    """

    world: World
    log: ScanLog
    truth: Array
    path_m: Array
    slips: tuple[SlipEvent, ...] = field(default=())


def first_scans(simulation: Simulation, count: int | None) -> Simulation:
    """The simulation as if it had ended after ``count`` scans (None: as it is)."""
    if count is None or count >= len(simulation.log):
        return simulation
    log = simulation.log
    rows = np.arange(count, dtype=np.int64)
    short = replace(
        log, scans=log.scans.select(rows), stamps_s=log.stamps_s[:count].copy(), odometry=log.odometry[:count].copy()
    )
    path_m = simulation.path_m[:count]
    slips = tuple(s for s in simulation.slips if s.start_m <= path_m[-1])
    return replace(simulation, log=short, truth=simulation.truth[:count].copy(), path_m=path_m, slips=slips)


def simulate(
    world: World,
    laser: LaserModel | None = None,
    odometry: OdometryModel | None = None,
    seed: int = 0,
    *,
    scan_interval_s: float = 0.2,
    speed_mps: float = 0.4,
    turn_rate_radps: float = 0.6,
    turn_radius_m: float = 0.4,
    speed_std_share: float = 0.0,
) -> Simulation:
    """Drive the world's route once, with a scan every ``scan_interval_s`` from the first point on, also while turning.

    The wheels turn at ``speed_mps`` whether they slip or not; with ``speed_std_share``, all speeds wander together by
    that share of themselves (standard deviation). Corners are arcs of ``turn_radius_m`` where these fit and turns on
    the spot elsewhere (0: everywhere). Each scan is taken at one instant. The stamps begin at 0, the odometry at
    ``(0, 0, 0)``, the truth at the route's first point. The same arguments give the same bytes.
    Raises MapmendError for an interval or speeds that are not positive, for a negative ``speed_std_share``, and for
    slips that overlap or do not fit.
    """
    if not (scan_interval_s > 0.0 and 0.0 <= speed_std_share < np.inf):
        given = f"{scan_interval_s} and {speed_std_share}"
        raise MapmendError(f"scan_interval_s must be positive and speed_std_share not negative, got {given}")
    laser, odometry = laser or LaserModel(), odometry or OdometryModel()
    slip_rng, odometry_rng, noise_rng, loss_rng, speed_rng = (default_rng(s) for s in SeedSequence(seed).spawn(5))
    straight = straight_stretches(plan_drive(world.route, speed_mps, turn_rate_radps, turn_radius_m))
    slips = _all_slips(odometry, straight, slip_rng)
    drive = plan_drive(world.route, speed_mps, turn_rate_radps, turn_radius_m, slips)
    driven_s = _scan_times(drive.duration_s, scan_interval_s, speed_std_share, speed_rng)
    stamps_s = np.round(np.arange(len(driven_s)) * scan_interval_s, 6)
    truth, path_m, wheel_m = drive.at(driven_s)
    log = ScanLog(
        scans=_scans(world, laser, truth, noise_rng, loss_rng),
        stamps_s=stamps_s,
        odometry=reported_odometry(truth, path_m, wheel_m, odometry, odometry_rng),
        source=f"simulated: {world.name}, seed {seed}",
    )
    return Simulation(world, log, truth, path_m, slips)


def _scan_times(duration_s: float, interval_s: float, std_share: float, rng: Generator) -> Array:
    """The times of the scans on a drive of ``duration_s`` at constant speeds, if the real speeds wander around
    these."""
    # Slightly more, so that a drive of a whole number of intervals ends with a scan, whatever the rounding.
    even = np.round(np.arange(int(duration_s / interval_s + 1e-9) + 1) * interval_s, 6)
    if std_share == 0.0:
        return even
    kept = np.exp(-interval_s / SPEED_WANDERS_S)
    times, off = [0.0], std_share * rng.standard_normal()
    while times[-1] <= duration_s:
        times.append(times[-1] + interval_s * max(1.0 + off, SLOWEST_SHARE))
        off = kept * off + np.sqrt(1.0 - kept**2) * std_share * rng.standard_normal()
    return np.array(times[:-1])


def reported_odometry(truth: Array, path_m: Array, wheel_m: Array, model: OdometryModel, rng: Generator) -> Array:
    """``T_odometry_robot`` for true poses (n, 3), the path on the ground (n,) and the path that the wheels report (n,).

    The first pose is (0, 0, 0). Motion that the wheels report and that did not happen goes along the robot's heading.
    """
    steps = between(truth[:-1], truth[1:])
    driven_m = np.diff(wheel_m)
    phantom_m = driven_m - np.diff(path_m)
    turn = steps[:, 2]
    forward = model.translation_scale * (steps[:, 0] + phantom_m * np.cos(turn / 2.0))
    sideways = model.translation_scale * (steps[:, 1] + phantom_m * np.sin(turn / 2.0))
    rotation = model.rotation_scale * turn + model.rotation_bias_radpm * driven_m
    metres, radians = np.abs(driven_m), np.abs(turn)
    noise = rng.standard_normal((len(steps), 3))
    forward_variance = model.forward_std_m_after_1_m**2 * metres + model.forward_std_m_after_1_rad**2 * radians
    rotation_variance = model.rotation_std_rad_after_1_m**2 * metres + model.rotation_std_rad_after_1_rad**2 * radians
    forward = forward + np.sqrt(forward_variance) * noise[:, 0]
    sideways = sideways + model.sideways_std_m_after_1_m * np.sqrt(metres) * noise[:, 1]
    rotation = rotation + np.sqrt(rotation_variance) * noise[:, 2]
    return _chained(forward, sideways, rotation)


def _chained(forward_m: Array, sideways_m: Array, rotation_rad: Array) -> Array:
    """The poses along n steps from (0, 0, 0), shape (n + 1, 3)."""
    heading = np.concatenate(([0.0], np.cumsum(rotation_rad)))
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = np.concatenate(([0.0], np.cumsum(cos * forward_m - sin * sideways_m)))
    y = np.concatenate(([0.0], np.cumsum(sin * forward_m + cos * sideways_m)))
    return np.column_stack((x, y, wrap_angle(heading)))


def _scans(world: World, laser: LaserModel, truth: Array, noise_rng: Generator, loss_rng: Generator) -> Scans:
    geometry = laser.geometry
    laser_poses = compose(truth, geometry.T_robot_laser)
    ranges = cast_rays(world.walls, laser_poses, geometry.bearings_rad(), geometry.max_range_m)
    ranges = ranges + laser.range_noise_std_m * noise_rng.standard_normal(ranges.shape)
    if laser.quantization_m > 0.0:
        ranges = np.round(ranges / laser.quantization_m) * laser.quantization_m
    readings = np.maximum(ranges, SHORTEST_RANGE_M).astype(np.float32)
    readings[(readings >= geometry.max_range_m) | (loss_rng.random(ranges.shape) < laser.lost_share)] = np.inf
    n = len(truth)
    return Scans(
        ranges_m=readings.ravel(),
        offsets=np.arange(n + 1, dtype=np.int64) * geometry.beam_count,
        geometry_index=np.zeros(n, dtype=np.int32),
        geometries=(geometry,),
    )


def _all_slips(model: OdometryModel, straight_m: Array, rng: Generator) -> tuple[SlipEvent, ...]:
    """The given slips and the random ones, each of the latter on one of the straight stretches."""
    slips = list(model.slips)
    lengths = straight_m[:, 1] - straight_m[:, 0]
    tries = 0
    while len(slips) < len(model.slips) + model.random_slip_count:
        tries += 1
        if tries > 100 * model.random_slip_count:
            raise MapmendError(
                f"{model.random_slip_count} random slips do not fit on {lengths.sum():.0f} m of straight driving; "
                "ask for fewer or shorter ones"
            )
        begin, end = straight_m[rng.choice(len(straight_m), p=lengths / lengths.sum())]
        slip = SlipEvent(
            float(rng.uniform(begin, end)),
            float(rng.uniform(*model.random_slip_length_m)),
            float(rng.uniform(*model.random_slip_share)),
        )
        if slip.end_m <= end and all(_are_apart(slip, other) for other in slips):
            slips.append(slip)
    return tuple(sorted(slips, key=lambda s: s.start_m))


def _are_apart(slip: SlipEvent, other: SlipEvent) -> bool:
    return slip.start_m >= other.end_m + GAP_BETWEEN_SLIPS_M or other.start_m >= slip.end_m + GAP_BETWEEN_SLIPS_M
