"""Arguments that several commands take, each beside the function that turns it into what the library takes."""

from __future__ import annotations

import os
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mapmend.config import Config
    from mapmend.io.bags.options import BagOptions

# The names that the library gives these, in a place that loads no NumPy; a test compares them.
METHODS = ("igo", "go", "scanmatch", "odometry", "gmapping")
KERNELS = ("huber", "cauchy", "geman-mcclure", "dcs", "switchable", "max-mixture", "gnc")
STARTS = ("given", "odometry", "tree", "chordal")


def whole_number(text: str) -> int:
    """An argument's whole number from 0 on."""
    value = int(text) if text.isdigit() and len(text) < 19 else -1
    if value < 0:
        raise ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return value


def positive_number(text: str) -> float:
    """An argument's number above 0."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1e6:
        raise ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def add_lenient(parser: ArgumentParser) -> None:
    parser.add_argument("--lenient", action="store_true", help="leave out the unusable lines of a log, and name them")


def add_threads(parser: ArgumentParser) -> None:
    """`thread_count` says how many."""
    parser.add_argument(
        "--threads", type=whole_number, default=0, metavar="N", help="default: one a core; never changes results"
    )


def thread_count(asked: int) -> int:
    """``asked``, or the number of usable cores if that is 0."""
    if asked:
        return asked
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def add_bag(parser: ArgumentParser) -> None:
    """What `bag_options` reads."""
    bag = parser.add_argument_group("ROS bags")
    bag.add_argument("--scan-topic", metavar="TOPIC", help="the topic of the laser, if the bag has several")
    bag.add_argument("--odom-topic", metavar="TOPIC", help="the topic of the odometry, if the bag has several; or /tf")
    bag.add_argument("--base-frame", metavar="FRAME", help="the robot's frame (default: the odometry's)")
    bag.add_argument(
        "--deskew", action="store_true", help="correct each sweep for the robot's motion during it, by time_increment"
    )


def bag_options(args: Namespace) -> BagOptions:
    """What the command line says about a ROS bag."""
    from mapmend.io.bags.options import BagOptions

    return BagOptions(args.scan_topic, args.odom_topic, args.base_frame, args.deskew)


def add_config(parser: ArgumentParser, what: str = "settings in TOML; settings not in it keep their defaults") -> None:
    """What `read_config` reads."""
    parser.add_argument("--config", metavar="FILE", help=what)


def read_config(args: Namespace) -> Config:
    """The settings in the file that ``--config`` names, or the defaults."""
    from mapmend.config import Config, read_toml

    return read_toml(args.config) if args.config else Config()


def add_settings(parser: ArgumentParser) -> None:
    """What `map_config` reads: the settings of whatever maps a log."""
    add_config(parser)
    parser.add_argument(
        "--robust",
        choices=("none", "auto"),
        default="none",
        help="auto: at the end, let the scans decide which loops count, as tune does (default: none)",
    )
    parser.add_argument("--align", action="store_true", help="turn the map so that most walls run along its axes")
    parser.add_argument("--seed", type=whole_number, metavar="N", help="seed of hypotheses and particles (default: 0)")
    parser.add_argument("--no-odometry", action="store_true", help="map from the laser alone")


def map_config(args: Namespace) -> Config:
    """The settings that the arguments of `add_settings` ask for."""
    asked = {
        "seed": args.seed,
        "motion.use_odometry": False if args.no_odometry else None,
        "loops.tune": True if args.robust == "auto" else None,
        "grid.align": True if args.align else None,
    }
    return read_config(args).with_settings({name: value for name, value in asked.items() if value is not None})
