"""``mapmend simulate``: a world, a log and its ground truth."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from typing import Any

from mapmend.commands.common.console import print_json, say_older
from mapmend.commands.common.options import positive_number, whole_number
from mapmend.commands.common.simulated import write_simulation
from mapmend.errors import MapmendError
from mapmend.io.output import check_writable, whole_or_nothing
from mapmend.io.own_files import SIMULATION_FILES
from mapmend.version import VERSION

WORLDS = ("corridor", "office", "random")


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "Writes log.clf, truth.tum and world.png. The same options give the same bytes."
    parser.add_argument("-o", "--output", metavar="DIR", required=True, help="folder to write")
    parser.add_argument("--world", choices=WORLDS, default=WORLDS[0], help="the building (default: corridor)")
    parser.add_argument(
        "--seed", type=whole_number, default=0, metavar="N", help="seed of building, noise and slips (default: 0)"
    )
    parser.add_argument(
        "--slips", type=whole_number, default=3, metavar="N", help="how often the wheels slip (default: 3)"
    )
    parser.add_argument(
        "--range-noise",
        type=positive_number,
        default=0.01,
        metavar="M",
        help="standard deviation of a range, m (default: 0.01)",
    )
    parser.add_argument(
        "--max-range", type=positive_number, default=8.0, metavar="M", help="the laser's largest range, m (default: 8)"
    )
    parser.add_argument("--scans", type=whole_number, metavar="N", help="end after N scans (default: the whole route)")


def run(args: Namespace) -> int:
    """Simulates and writes log.clf, truth.tum, world.png, and run.json, which describes the simulation."""
    from mapmend.simulation import LaserModel, OdometryModel, first_scans, simulate, world_named
    from mapmend.trajectory import path_length_m

    check_writable(args.output, SIMULATION_FILES)
    if args.scans is not None and args.scans < 1:
        raise MapmendError("--scans must be at least 1")
    laser = LaserModel(range_noise_std_m=args.range_noise)
    laser = replace(laser, geometry=replace(laser.geometry, max_range_m=args.max_range))
    odometry = OdometryModel(random_slip_count=args.slips)
    simulation = first_scans(simulate(world_named(args.world, args.seed), laser, odometry, args.seed), args.scans)
    values: dict[str, Any] = {
        "mapmend": VERSION,
        "world": simulation.world.name,
        "seed": args.seed,
        "scans": len(simulation.log),
        "duration_s": float(simulation.log.stamps_s[-1]),
        "path_m": path_length_m(simulation.truth),
        "slips": [{"start_m": s.start_m, "length_m": s.length_m, "share": s.share} for s in simulation.slips],
    }
    with whole_or_nothing(args.output, SIMULATION_FILES) as output:
        write_simulation(simulation, output.path)
        run_json = output.write_run_json(values)
    say_older(run_json)
    if args.json:
        print_json({**values, "output": args.output})
    else:
        print(
            f"{values['world']}: {values['scans']} scans, {values['path_m']:.1f} m of path, "
            f"{values['duration_s']:.0f} s, {len(values['slips'])} slips\n"
            f"  log: {args.output}/log.clf, truth: {args.output}/truth.tum, picture: {args.output}/world.png"
        )
    return 0
