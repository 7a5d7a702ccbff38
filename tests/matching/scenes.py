"""Places in random buildings: a grid made from exact poses, and what a laser sees from anywhere else."""

from functools import cache

import numpy as np

from mapmend.config import ScanConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.scan import LaserGeometry, Scans
from mapmend.scan_graph.points import ScanPoints
from mapmend.simulation import random_building
from mapmend.simulation.drive import plan_drive
from mapmend.simulation.ray_casting import cast_rays

LASER = LaserGeometry(360, -np.pi, np.pi / 180.0, 12.0)
NOISE_STD_M = 0.01


class Scene:
    """A stretch of the drive through a random building; ``here`` (3,) is a pose in its middle."""

    def __init__(self, seed):
        self.world = random_building(seed)
        drive = plan_drive(self.world.route, 0.4, 0.6, 0.4)
        middle = drive.duration_s * (0.2 + 0.6 * np.random.default_rng(seed).uniform())
        self.poses = drive.at(middle + np.linspace(-6.0, 6.0, 25))[0]
        self.here = self.poses[12]
        self.grid = SurfaceGrid(0.05)
        for k, pose in enumerate(self.poses):
            self.grid.insert(self.scan_at(pose, 100 + k), np.zeros(3), pose)

    def scan_at(self, pose, seed):
        """The points (n, 5) that a noisy laser sees from a pose."""
        ranges = cast_rays(self.world.walls, np.array([pose]), LASER.bearings_rad(), LASER.max_range_m)[0]
        ranges = ranges + NOISE_STD_M * np.random.default_rng(seed).standard_normal(len(ranges))
        scans = Scans(ranges.astype(np.float32), np.array([0, len(ranges)]), np.zeros(1, np.int32), (LASER,))
        return ScanPoints(scans, ScanConfig()).of(0)


@cache
def scene(seed):
    return Scene(seed)


def errors(found, true):
    """Distance in metres and angle in radians between two poses."""
    step = se2.between(true, found)
    return float(np.hypot(step[0], step[1])), float(abs(step[2]))
