"""``mapmend simulate``: a world, a log and its ground truth."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mapmend import __version__
from mapmend.commands.console import print_json
from mapmend.errors import MapmendError
from mapmend.io.carmen import write_carmen
from mapmend.io.output import RUN_FILE, check_writable, whole_or_nothing, write_whole
from mapmend.io.tum import write_tum
from mapmend.simulation import (
    LaserModel,
    OdometryModel,
    Simulation,
    World,
    corridor_loop,
    office_floor,
    random_building,
    simulate,
)
from mapmend.trajectory import path_length_m
from mapmend.view.figures import draw_world

WORLDS: dict[str, Callable[[int], World]] = {
    "corridor": lambda _seed: corridor_loop(),
    "office": lambda _seed: office_floor(),
    "random": random_building,
}


def run(options: Namespace) -> int:
    """Simulates and writes log.clf, truth.tum, world.png, and a page that says from what."""
    check_writable(options.output)
    if options.scans is not None and options.scans < 1:
        raise MapmendError("--scans must be at least 1")
    laser = LaserModel(range_noise_std_m=options.range_noise)
    laser = replace(laser, geometry=replace(laser.geometry, max_range_m=options.max_range))
    odometry = OdometryModel(random_slip_count=options.slips)
    simulation = first_scans(
        simulate(WORLDS[options.world](options.seed), laser, odometry, options.seed), options.scans
    )
    values: dict[str, Any] = {
        "mapmend": __version__,
        "world": simulation.world.name,
        "seed": options.seed,
        "scans": len(simulation.log),
        "duration_s": float(simulation.log.stamps_s[-1]),
        "path_m": path_length_m(simulation.truth),
        "slips": [{"start_m": s.start_m, "length_m": s.length_m, "share": s.share} for s in simulation.slips],
    }
    with whole_or_nothing(options.output) as place:
        write_simulation(simulation, place)
        write_whole(place / RUN_FILE, json.dumps(values, indent=2) + "\n")
    if options.json:
        print_json({**values, "output": options.output})
    else:
        print(
            f"{values['world']}: {values['scans']} scans, {values['path_m']:.1f} m of path, "
            f"{values['duration_s']:.0f} s, {len(values['slips'])} slips\n"
            f"  log: {options.output}/log.clf, truth: {options.output}/truth.tum, picture: {options.output}/world.png"
        )
    return 0


def write_simulation(simulation: Simulation, place: Path) -> None:
    """log.clf, truth.tum (robot poses in the world) and world.png into a folder."""
    write_carmen(place / "log.clf", simulation.log)
    write_tum(place / "truth.tum", simulation.log.stamps_s, simulation.truth)
    draw_world(simulation.world.walls, simulation.truth, place / "world.png", simulation.world.name)


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
