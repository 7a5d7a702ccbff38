"""``mapmend eval``: a trajectory against relations, a reference, or both."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmend.commands.common.console import print_json
from mapmend.commands.common.options import add_lenient
from mapmend.errors import InputError, MapmendError

if TYPE_CHECKING:
    from mapmend.geometry.se2 import Array as Float
    from mapmend.scan import Scans


@dataclass(frozen=True)
class TimedPoses:
    """Robot poses (n, 3) at stamps (n,); ``T_robot_laser`` if the file has it, and ``what`` the poses are."""

    stamps_s: Float
    poses: Float
    what: str
    T_robot_laser: tuple[float, float, float] | None = None


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "Of a log its raw odometry is measured, of a graph with stamps its nodes."
    parser.add_argument("file", metavar="RUN|FILE", help="a RUN folder, a TUM trajectory, a log or a graph")
    parser.add_argument("--relations", metavar="F", help="relations 't1 t2 x y z roll pitch yaw' (Kuemmerle et al.)")
    parser.add_argument("--reference", metavar="F", help="a trajectory to align with: absolute trajectory error")
    parser.add_argument("--laser-frame", action="store_true", help="compare poses of the laser, not of the robot")
    add_lenient(parser)


def run(args: Namespace) -> int:
    """Measures ``args.file``; there is no verdict, so the exit code is 0."""
    import numpy as np

    if not (args.relations or args.reference):
        raise MapmendError("nothing to compare with; give --relations F or --reference F")
    measured = load(args.file, args.lenient)
    values: dict[str, Any] = {"what": measured.what, "frame": "laser" if args.laser_frame else "robot"}
    mounting = None
    if args.laser_frame:
        if measured.T_robot_laser is None:
            raise InputError(args.file, "does not tell where the laser sits", "give a RUN or a log")
        mounting = np.array(measured.T_robot_laser)
    if args.relations:
        values |= _against_relations(measured, args.relations, mounting)
    if args.reference:
        values |= _against_reference(measured, args.reference, args.lenient, mounting)
    if args.json:
        print_json(values)
    else:
        print("\n".join(_lines(values)))
    return 0


def load(path: str, lenient: bool = False) -> TimedPoses:
    """The poses in a RUN folder, trajectory, log (raw odometry) or graph with stamps; raises InputError."""
    import numpy as np

    from mapmend.datasets.cache import named_file
    from mapmend.graph.pose_graph import PoseGraph
    from mapmend.io.info import describe_content
    from mapmend.io.reader import read, read_run
    from mapmend.scan import ScanLog
    from mapmend.trajectory import Trajectory

    if Path(path).is_dir():
        trajectory, graph = read_run(path)
        mounting = None if graph is None else _mounting(graph.scans)
        return TimedPoses(trajectory.stamps_s, trajectory.poses, "trajectory of the run", mounting)
    content = read(named_file(path), lenient)
    if isinstance(content, Trajectory):
        return TimedPoses(content.stamps_s, content.poses, "trajectory")
    if isinstance(content, ScanLog):
        if not content.has_stamps:
            raise InputError(path, "the log has no usable timestamps", "evaluation pairs poses by time; name another")
        return TimedPoses(content.stamps_s, content.odometry, "raw odometry of the log", _mounting(content.scans))
    if isinstance(content, PoseGraph) and content.stamps_s is not None:
        known = np.isfinite(content.stamps_s)
        return TimedPoses(content.stamps_s[known], content.poses[known], "nodes of the graph", _mounting(content.scans))
    kind = describe_content(content).kind
    raise InputError(path, f"a {kind} without poses over time", "name a RUN, a TUM trajectory, a log or a graph")


def _mounting(scans: Scans | None) -> tuple[float, float, float] | None:
    """The mounting of the laser, if all lasers have the same."""
    mountings = set() if scans is None else {geometry.T_robot_laser for geometry in scans.geometries}
    return mountings.pop() if len(mountings) == 1 else None


def _against_relations(measured: TimedPoses, path: str, mounting: Float | None) -> dict[str, Any]:
    from mapmend.datasets.cache import named_file
    from mapmend.evaluation.relations import relation_errors
    from mapmend.io.relations import read_relations

    true = read_relations(named_file(path))
    errors = relation_errors(
        measured.stamps_s, measured.poses, true.t1_s, true.t2_s, true.relative_poses, T_robot_laser=mounting
    )
    names = ("translation_mean_m", "translation_std_m", "rotation_mean_deg", "rotation_std_deg", "used", "total")
    return {name: getattr(errors, name) for name in names}


def _against_reference(measured: TimedPoses, path: str, lenient: bool, mounting: Float | None) -> dict[str, Any]:
    """The reference is used as it is: with the laser's frame, only the measured poses are moved to the laser."""
    from mapmend.evaluation.trajectory import trajectory_errors
    from mapmend.geometry.se2 import compose

    reference = load(path, lenient)
    poses = measured.poses if mounting is None else compose(measured.poses, mounting)
    errors = trajectory_errors(measured.stamps_s, poses, reference.stamps_s, reference.poses)
    return {
        "absolute_rmse_m": errors.translation_rmse_m,
        "absolute_mean_m": errors.translation_mean_m,
        "absolute_median_m": errors.translation_median_m,
        "absolute_max_m": errors.translation_max_m,
        "absolute_rotation_mean_deg": errors.rotation_mean_deg,
        "absolute_used": errors.used,
        "absolute_total": errors.total,
    }


def _lines(values: dict[str, Any]) -> list[str]:
    lines = [f"{values['what']}, poses of the {values['frame']}"]
    if "total" in values:
        lines += [
            f"relations: {values['used']} of {values['total']} used",
            f"  translation: {values['translation_mean_m']:.4f} m +- {values['translation_std_m']:.4f} m",
            f"  rotation: {values['rotation_mean_deg']:.3f} deg +- {values['rotation_std_deg']:.3f} deg",
        ]
    if "absolute_total" in values:
        lines += [
            f"absolute trajectory error, aligned: {values['absolute_used']} of {values['absolute_total']} poses used",
            f"  translation: RMSE {values['absolute_rmse_m']:.4f} m, mean {values['absolute_mean_m']:.4f} m, "
            f"median {values['absolute_median_m']:.4f} m, largest {values['absolute_max_m']:.4f} m",
            f"  rotation: mean {values['absolute_rotation_mean_deg']:.3f} deg",
        ]
    return lines
