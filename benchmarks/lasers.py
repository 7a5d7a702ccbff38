"""Does the accuracy depend on the laser? Simulated buildings, lasers of seven kinds, with good wheels, bad ones and
none.

The lasers are models: beams, field of view, range, noise and rate as published by makers and users. Bad wheels turn
0.02 rad too far per metre, count 3 % too much, are more than twice as noisy, and slip three times. Each cell is the
absolute trajectory error with defaults, median and worst over the buildings.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from _measure import markdown

from mapmend.config import Config
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.front_end.builder import FrontEnd
from mapmend.igo.iterate import iterate
from mapmend.scan import LaserGeometry
from mapmend.simulation import LaserModel, OdometryModel, World, office_floor, random_building, simulate


@dataclass(frozen=True)
class Robot:
    """A laser, how often it scans, and how fast the robot goes."""

    laser: LaserModel
    interval_s: float
    speed_mps: float = 0.4


def geometry(
    beams: int, view_deg: float, max_range_m: float, place: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> LaserGeometry:
    """Beams evenly over a field of view that looks ahead; of a whole turn, the last is one step before the first."""
    gaps = beams if view_deg == 360.0 else beams - 1
    return LaserGeometry(beams, -np.radians(view_deg) / 2.0, np.radians(view_deg) / gaps, max_range_m, place)


ROBOTS = {
    "RPLidar A1: 360 beams, 12 m": Robot(
        LaserModel(geometry(360, 360.0, 12.0, (0.1, 0.0, 3.1)), 0.02, 0.0, 0.02), 0.18
    ),
    "URG-04LX: 682 beams, 240°, 4 m": Robot(LaserModel(geometry(682, 239.8, 4.0, (0.15, 0.0, 0.0)), 0.02, 0.001), 0.1),
    "UTM-30LX: 1,081 beams, 270°": Robot(LaserModel(geometry(1081, 270.0, 30.0, (0.2, 0.0, 0.0)), 0.015, 0.001), 0.1),
    "S300: 541 beams, 270°, at 1 m/s": Robot(
        LaserModel(geometry(541, 270.0, 30.0, (0.3, 0.2, 0.78)), 0.015, 0.01), 0.08, 1.0
    ),
    "Neato: 360 beams, 5 m, a tenth lost": Robot(
        LaserModel(geometry(360, 360.0, 5.0, (-0.1, 0.0, 0.0)), 0.03, 0.0, 0.1), 0.2, 0.3
    ),
    "91 beams, 180°, 3 cm of noise, every 0.25 m": Robot(
        LaserModel(geometry(91, 180.0, 16.0), 0.03, 0.0, 0.05), 0.5, 0.5
    ),
    "1,441 beams, 180°, 3 cm of noise": Robot(LaserModel(geometry(1441, 180.0, 8.0), 0.03), 0.2),
}
BAD_WHEELS = OdometryModel(
    forward_std_m_after_1_m=0.05,
    rotation_std_rad_after_1_m=0.03,
    rotation_bias_radpm=0.02,
    translation_scale=1.03,
    random_slip_count=3,
)
WHEELS = {"good": None, "bad": BAD_WHEELS, "none": None}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="random buildings, beside the office (4)")
    parser.add_argument("--first", type=int, default=300, metavar="SEED", help="of the first (default: 300)")
    parser.add_argument(
        "--lasers", nargs="+", metavar="NAME", help="those whose names hold one of these (default: all)"
    )
    options = parser.parse_args()
    print(markdown(("laser", "wheels", "go [m]", "igo [m]", "igo worse by at most [mm]"), []), flush=True)
    for name, robot in ROBOTS.items():
        if options.lasers and not any(part in name for part in options.lasers):
            continue
        for wheels in WHEELS:
            both = [errors(world, robot, wheels, seed) for world, seed in worlds(options.first, options.seeds)]
            go, igo = ([pair[k] for pair in both] for k in (0, 1))
            worse = max(0.0, *(b - a for a, b in both))
            cells = (*(f"{statistics.median(e):.3f} ({max(e):.3f})" for e in (go, igo)), f"{1e3 * worse:.1f}")
            print(f"| {' | '.join((name, wheels, *cells))} |", flush=True)


def worlds(first: int, count: int) -> Iterator[tuple[World, int]]:
    """The buildings, each with the seed of its drive."""
    yield office_floor(), first
    yield from ((random_building(seed), seed) for seed in range(first, first + count))


def errors(world: World, robot: Robot, wheels: str, seed: int) -> tuple[float, float]:
    """The absolute trajectory errors of go and of igo, metres."""
    drive = simulate(
        world, robot.laser, WHEELS[wheels], seed, scan_interval_s=robot.interval_s, speed_mps=robot.speed_mps
    )
    config, log = Config(), drive.log
    if wheels == "none":
        config = replace(config, motion=replace(config.motion, use_odometry=False))
    graph = FrontEnd(log.scans.geometries, config).run(log)

    def error_m() -> float:
        poses = graph.scan_poses()
        return trajectory_errors(log.stamps_s, poses, log.stamps_s, drive.truth).translation_rmse_m

    by_go = error_m()
    iterate(graph)
    return by_go, error_m()


if __name__ == "__main__":
    main()
