"""Logs for the front end's tests: simulated drives, and ways to spoil them."""

from dataclasses import replace
from functools import cache

import numpy as np

from mapmend.config import Config
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.geometry import se2
from mapmend.scan import LaserGeometry, ScanLog, Scans
from mapmend.simulation import LaserModel, OdometryModel, random_building, simulate

WITHOUT_LOOPS = replace(Config(), loops=replace(Config().loops, enabled=False))
SHORT_SIGHTED = LaserModel(LaserGeometry(180, -np.pi / 2, np.pi / 180, 5.0), range_noise_std_m=0.02)
NOISY = LaserModel(range_noise_std_m=0.03)
BENT = OdometryModel(rotation_bias_radpm=0.02, translation_scale=1.03)


@cache
def drive(building, laser=None, odometry=None, seed=1):
    return simulate(random_building(building), laser, odometry, seed)


def mapped(log, config=None):
    """The front end after the whole log."""
    front_end = FrontEnd(log.scans.geometries, config or Config())
    front_end.run(log)
    return front_end


def errors_of(simulation, poses):
    """Absolute errors of one pose for each scan against the truth."""
    stamps = simulation.log.stamps_s
    return trajectory_errors(stamps, poses, stamps, simulation.truth)


def with_steps(log, change):
    """The log with other odometry: ``change`` is given the steps (n - 1, 3) to alter in place."""
    steps = se2.between(log.odometry[:-1], log.odometry[1:])
    change(steps)
    poses = [log.odometry[0]]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    return replace(log, odometry=np.array(poses))


def empty_log(n):
    """n scans without a single return, standing still."""
    geometry = LaserGeometry(4, 0.0, 0.1, 10.0)
    scans = Scans(
        np.full(4 * n, np.inf, np.float32), 4 * np.arange(n + 1, dtype=np.int64), np.zeros(n, np.int32), (geometry,)
    )
    return ScanLog(scans, np.arange(n, dtype=float), np.zeros((n, 3)))
