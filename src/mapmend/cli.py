"""The command line: arguments in, calls, exit codes out.

argparse, and nothing else until a command is chosen: ``mapmend --help`` answers before NumPy would be loaded. Exit
codes: 0 for yes, 1 for no, 2 for could not (one line on standard error), 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING, NoReturn, TypeAlias

from mapmend import __version__
from mapmend.errors import MapmendError

if TYPE_CHECKING:
    Commands: TypeAlias = argparse._SubParsersAction["_Parser"]

COULD_NOT, INTERRUPTED = 2, 130
TRACEBACK_VARIABLE = "MAPMEND_TRACEBACK"

METHODS = ("igo", "go", "scanmatch", "odometry", "gmapping")
COMPARED = ("odometry", "scanmatch", "gmapping", "go", "igo")
KERNELS = ("none", "huber", "cauchy", "geman-mcclure", "dcs", "switchable", "max-mixture", "gnc")
STARTS = ("given", "odometry", "tree", "chordal")
FORMATS = ("carmen", "mcap", "sqlite3", "g2o", "toro", "tum", "kitti")
WORLDS = ("corridor", "office", "random")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command, ``sys.argv`` by default, and returns its exit code. What goes wrong is said in one line."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    try:
        options = parser().parse_args(arguments)
        # Every command has a module of its own under mapmend.commands, with a function run(options) -> exit code.
        code: int = import_module(f"mapmend.commands.{options.module}").run(options)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return _fail("interrupted; nothing was written", INTERRUPTED)
    except MapmendError as error:
        return _fail(str(error), COULD_NOT)
    except MemoryError:
        return _fail("not enough memory; take larger cells (grid.cell_size_m) or a shorter log", COULD_NOT)
    except BrokenPipeError:
        # Whoever read our output has seen enough; the interpreter must not complain about it at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return COULD_NOT
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _fail(f"{place}{error.strerror or error}; check the path and the disk", COULD_NOT)
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        what = f"{type(error).__name__}: {error}"
        return _fail(f"internal error ({what}); set {TRACEBACK_VARIABLE}=1 and report what it shows", COULD_NOT)


def _fail(what: str, code: int) -> int:
    """One line on standard error, whatever the message holds."""
    line = " ".join(what.split())
    # A person's terminal may stand in the middle of a progress bar's line.
    start = "\r" if sys.stderr.isatty() else ""
    print(f"{start}mapmend: {line}", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """Wrong arguments are one line too, not a page of usage."""

    def error(self, message: str) -> NoReturn:
        raise MapmendError(f"{message}; see {self.prog} --help")


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    top = _Parser(prog="mapmend", description="2D laser SLAM that mends its own graph.", allow_abbrev=False)
    top.add_argument("--version", action="version", version=f"mapmend {__version__}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_demo(commands)
    _add_info(commands)
    _add_map(commands)
    _add_optimize(commands)
    _add_compare(commands)
    _add_check(commands)
    _add_tune(commands)
    _add_eval(commands)
    _add_convert(commands)
    _add_datasets(commands)
    _add_simulate(commands)
    _add_report(commands)
    _add_view(commands)
    return top


def _command(commands: Commands, name: str, module: str, summary: str, more: str = "") -> argparse.ArgumentParser:
    description = f"{summary[0].upper()}{summary[1:]}. {more}".strip()
    command = commands.add_parser(name, help=summary, description=description, allow_abbrev=False)
    command.add_argument("--json", action="store_true", help="print one JSON object on standard output, nothing else")
    command.set_defaults(module=module)
    return command


def _add_demo(commands: Commands) -> None:
    command = _command(
        commands,
        "demo",
        "demo",
        "simulate a building with a slippery corridor, map it by each method, and compare with the truth",
        "Leaves the log, the truth, a RUN folder a method, and demo.png. Replaces an earlier demo.",
    )
    command.add_argument("-o", "--output", metavar="DIR", default="demo", help="where to (default: demo)")
    command.add_argument("--seed", type=_whole, default=1, metavar="N", help="seed of noise and slips (default: 1)")
    _add_threads(command)


def _add_info(commands: Commands) -> None:
    command = _command(commands, "info", "info", "say what a log, graph, trajectory or map holds, and what is odd")
    command.add_argument("file", metavar="FILE", help="the file (.gz and .bz2 as they are), a ROS bag, or a RUN folder")
    _add_bag(command)
    _add_lenient(command)


def _add_map(commands: Commands) -> None:
    command = _command(
        commands,
        "map",
        "map_log",
        "map a log: trajectory, pose graph with scans, and occupancy map in a RUN folder",
        "The RUN folder holds trajectory.tum, graph.g2o, map.pgm with map.yaml, map.png and run.json.",
    )
    command.add_argument("log", metavar="LOG", help="a CARMEN log (.gz and .bz2 as they are) or a ROS bag")
    command.add_argument("-o", "--output", metavar="RUN", required=True, help="the folder to write; replaces a RUN")
    command.add_argument(
        "--method",
        choices=METHODS,
        default=METHODS[0],
        help="igo: matching, loops, optimization, biased edges mended (default); go: not mended; scanmatch: no loops; "
        "odometry: as the log says; gmapping: a particle filter",
    )
    _add_settings(command)
    _add_bag(command)
    _add_lenient(command)
    _add_threads(command)


def _add_compare(commands: Commands) -> None:
    command = _command(
        commands,
        "compare",
        "compare",
        "map a log by several methods: error, seconds, memory and verdict of each, and a picture of all maps",
        "Leaves a RUN folder a method, compare.png and run.json, which says it all.",
    )
    command.add_argument("log", metavar="LOG", help="a CARMEN log or a ROS bag, as for map")
    command.add_argument("-o", "--output", metavar="DIR", default="compare", help="where to (default: compare)")
    command.add_argument("--relations", metavar="F", help="true relations, for the errors; see eval")
    command.add_argument(
        "--methods",
        nargs="+",
        choices=METHODS,
        default=list(COMPARED),
        metavar="M",
        help=f"which (default: {' '.join(COMPARED)})",
    )
    _add_settings(command)
    _add_bag(command)
    _add_lenient(command)
    _add_threads(command)


def _add_optimize(commands: Commands) -> None:
    command = _command(
        commands,
        "optimize",
        "optimize",
        "move the nodes of a pose graph to where they agree best with its edges",
        "Reads and writes g2o and TORO; scans on the nodes travel along. With a kernel, says which loops it distrusts.",
    )
    command.add_argument("graph", metavar="GRAPH", help="a g2o or TORO graph (.gz and .bz2 as they are)")
    command.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        required=True,
        help="the file to write: .g2o, or .toro or .graph; by any other name as GRAPH is",
    )
    command.add_argument(
        "--kernel", choices=KERNELS, default=KERNELS[0], help="what loops cost that may be false (default: none)"
    )
    command.add_argument(
        "--phi",
        type=_positive,
        metavar="X",
        help="chi2 at which the kernel begins to doubt (default: its own)",
    )
    command.add_argument(
        "--init",
        choices=("auto", *STARTS),
        default="auto",
        help="where to start: at the poses in GRAPH (given), along the odometry (best with a kernel), along a tree of "
        "the best edges, or rotations first (chordal); auto (default): given, and chordal too where that ends badly",
    )
    command.add_argument("--all-edges", action="store_true", help="let the kernel doubt odometry edges too")
    _add_threads(command)


def _add_check(commands: Commands) -> None:
    command = _command(
        commands,
        "check",
        "check",
        "say whether a map is consistent, and where not: exit code 0 for yes, 1 for no",
        "Needs a pose graph whose nodes carry scans, and no ground truth. Leaves check.png.",
    )
    command.add_argument("graph", metavar="RUN|GRAPH", help="a RUN folder, or a g2o or TORO graph (.gz and .bz2 too)")
    command.add_argument("-o", "--output", metavar="DIR", help="where check.png goes (default: the RUN, or here)")
    command.add_argument("--config", metavar="FILE", help="settings in TOML; what is not in it keeps its default")
    _add_threads(command)


def _add_tune(commands: Commands) -> None:
    command = _command(
        commands,
        "tune",
        "tune",
        "find the kernel's parameter that gives the most consistent map: exit code 1 where none gives a consistent one",
        "Needs a pose graph whose nodes carry scans, and no ground truth. Says which loops it switched off.",
    )
    command.add_argument("graph", metavar="RUN|GRAPH", help="a RUN folder, or a g2o or TORO graph (.gz and .bz2 too)")
    command.add_argument(
        "-o",
        "--output",
        metavar="OUT",
        help="a folder for graph.g2o and tune.png, or the graph's name (.g2o, .toro, .graph), tune.png beside it "
        "(default: write nothing)",
    )
    command.add_argument("--kernel", choices=KERNELS[1:], default="dcs", help="what loops cost (default: dcs)")
    command.add_argument(
        "--init",
        choices=STARTS,
        default="odometry",
        help="where every solve starts: along the odometry (default), at the poses in GRAPH, along a tree of the best "
        "edges, or rotations first",
    )
    command.add_argument("--config", metavar="FILE", help="settings in TOML; what is not in it keeps its default")
    _add_threads(command)


def _add_eval(commands: Commands) -> None:
    command = _command(
        commands,
        "eval",
        "evaluate",
        "measure a trajectory's errors against true relations or a reference trajectory",
        "Of a log the raw odometry is measured, of a graph with stamps its nodes.",
    )
    command.add_argument("file", metavar="RUN|FILE", help="a RUN folder, a TUM trajectory, a log or a graph")
    command.add_argument("--relations", metavar="F", help="relations 't1 t2 x y z roll pitch yaw' (Kuemmerle et al.)")
    command.add_argument("--reference", metavar="F", help="a trajectory to align with: absolute trajectory error")
    command.add_argument("--laser-frame", action="store_true", help="compare poses of the laser, not of the robot")
    _add_lenient(command)


def _add_simulate(commands: Commands) -> None:
    command = _command(
        commands,
        "simulate",
        "simulate",
        "drive a robot through a building and write its log, the truth and a picture",
        "Writes log.clf, truth.tum and world.png. The same options give the same bytes.",
    )
    command.add_argument("-o", "--output", metavar="DIR", required=True, help="the folder to write")
    command.add_argument("--world", choices=WORLDS, default=WORLDS[0], help="the building (default: corridor)")
    command.add_argument("--seed", type=_whole, default=0, metavar="N", help="seed of world, noise, slips (default: 0)")
    command.add_argument("--slips", type=_whole, default=3, metavar="N", help="how often the wheels slip (default: 3)")
    command.add_argument("--range-noise", type=_positive, default=0.01, metavar="M", help="m, 1 sigma (default: 0.01)")
    command.add_argument("--max-range", type=_positive, default=8.0, metavar="M", help="the laser's, m (default: 8)")
    command.add_argument("--scans", type=_whole, metavar="N", help="end after N scans (default: the whole route)")


def _add_convert(commands: Commands) -> None:
    command = _command(
        commands,
        "convert",
        "convert",
        "write a log, graph or trajectory in another format",
        "CARMEN and ROS 2 bags hold logs, g2o and TORO graphs, TUM and KITTI trajectories. Says what is lost; refuses "
        "what makes no sense, with the reason.",
    )
    command.add_argument("source", metavar="IN", help="a log, ROS bag, graph or trajectory, or a RUN folder")
    command.add_argument("target", metavar="OUT", help="what to write: .clf .log .mcap .g2o .toro .graph .tum .kitti")
    command.add_argument("--to", choices=FORMATS, help="the format, where OUT's name does not tell (a folder: a bag)")
    command.add_argument("--stamps", metavar="FILE", help="a time in seconds a line, for poses that have none")
    _add_bag(command)
    _add_lenient(command)


def _add_datasets(commands: Commands) -> None:
    command = _command(
        commands,
        "datasets",
        "datasets",
        "list public logs, or fetch them by name",
        "A fetched log is read by its name: mapmend map intel -o RUN.",
    )
    command.add_argument("action", choices=("list", "fetch"), nargs="?", default="list", help="default: list")
    command.add_argument("names", metavar="NAME", nargs="*", help="what to fetch")
    command.add_argument("--mirror", metavar="URL", help="fetch from here, where the files lie by their names")


def _add_report(commands: Commands) -> None:
    command = _command(
        commands,
        "report",
        "report",
        "write one HTML page of a RUN: its map, its graph, and what the check says of it",
        "The page holds all of its data, opens in any browser, and asks no network for anything.",
    )
    command.add_argument("run", metavar="RUN", help="the folder that `mapmend map` wrote")
    command.add_argument("--compare", metavar="RUN", nargs="+", default=[], help="others to show beside it")
    command.add_argument("-o", "--output", metavar="FILE", help="the page to write (default: RUN/report.html)")
    command.add_argument("--config", metavar="FILE", help="settings of the check, in TOML")
    _add_threads(command)


def _add_view(commands: Commands) -> None:
    command = _command(
        commands,
        "view",
        "view",
        "replay a RUN over time in rerun: the robot, its scans, the graph as it grows, the map",
        "Needs rerun: pip install 'mapmend[view]'.",
    )
    command.add_argument("run", metavar="RUN", help="the folder that `mapmend map` wrote")
    command.add_argument("--save", metavar="FILE", help="write a recording (.rrd) and open no window")


def _add_lenient(command: argparse.ArgumentParser) -> None:
    command.add_argument("--lenient", action="store_true", help="leave unusable lines of a log out, and say so")


def _add_settings(command: argparse.ArgumentParser) -> None:
    """What `configuration` in commands/map_log.py asks for."""
    command.add_argument("--config", metavar="FILE", help="settings in TOML; what is not in it keeps its default")
    command.add_argument(
        "--robust",
        choices=("none", "auto"),
        default="none",
        help="auto: at the end, choose by the scans how far loops are doubted, as tune does (default: none)",
    )
    command.add_argument("--align", action="store_true", help="turn the map so that most walls run along its axes")
    command.add_argument("--seed", type=_whole, metavar="N", help="seed of hypotheses and particles (default: 0)")
    command.add_argument("--no-odometry", action="store_true", help="map from the laser alone")


def _add_bag(command: argparse.ArgumentParser) -> None:
    bag = command.add_argument_group("ROS bags")
    bag.add_argument("--scan-topic", metavar="TOPIC", help="the laser's, where there are several")
    bag.add_argument("--odom-topic", metavar="TOPIC", help="the odometry's, where there are several; or /tf")
    bag.add_argument("--base-frame", metavar="FRAME", help="the robot's frame (default: the odometry's)")
    bag.add_argument("--deskew", action="store_true", help="straighten the sweeps of a moving robot by time_increment")


def _add_threads(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--threads", type=_whole, default=0, metavar="N", help="default: one a core; never changes results"
    )


def _whole(text: str) -> int:
    value = int(text) if text.isdigit() and len(text) < 19 else -1
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return value


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value
