"""A RUN over time in rerun: the robot, its scans, the graph as it grows, and the map. Needs the extra ``view``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import transform_points
from mapmend.graph.optimizer import edge_chi2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.maps import FREE, OCCUPIED, OccupancyMap
from mapmend.scan import Scans
from mapmend.trajectory import Trajectory
from mapmend.view.map_picture import FREE_COLOUR, OCCUPIED_COLOUR, UNKNOWN_COLOUR

if TYPE_CHECKING:
    from rerun import RecordingStream
    from rerun.blueprint import Blueprint

Float = NDArray[np.float64]

TIME = "time"
MAP, TRAJECTORY, ROBOT = "world/map", "world/trajectory", "world/robot"
SCAN, NODES, KEY_NODES, LOOPS, CHI2 = "world/scan", "world/nodes", "world/key_nodes", "world/loops", "loops/chi2"
GROWING = (TRAJECTORY, NODES, KEY_NODES, LOOPS)
"""These entities are shown from any time before the current one; of the others, only the newest is shown."""

TRAJECTORY_COLOUR, NODE_COLOUR, KEY_COLOUR, SCAN_COLOUR = (21, 101, 192), (28, 79, 138), (230, 119, 0), (11, 114, 133)
LOOP_COLOUR, STRAINED_COLOUR = (124, 147, 173), (201, 42, 42)
USUAL_CHI2 = 11.345
"""99 % of true edges, three degrees of freedom, are below this."""

ROBOT_M, TRAJECTORY_M, LIFT_M = 0.5, 0.02, 0.02
EYE_HEIGHT, ROOM_M = 1.0, 8.0
"""The height of the viewpoint, in units of the size of the drive with the rooms around it."""

REPLAY_S = 60.0
MISSING = "rerun is not installed; pip install 'mapmend[view]'"


@dataclass(frozen=True)
class Recording:
    """The recording, and the initial layout of rerun's window."""

    stream: RecordingStream
    blueprint: Blueprint


def check_installed() -> None:
    """Raises MapmendError, which says what to install, if rerun is not installed."""
    try:
        import rerun  # noqa: F401
    except ImportError:
        raise MapmendError(MISSING) from None


def record(trajectory: Trajectory, graph: PoseGraph, grid: OccupancyMap, key_nodes: list[int], name: str) -> Recording:
    """A whole RUN as a rerun recording; ``key_nodes`` are ids. Raises MapmendError.

    Times are seconds since the first scan. A node appears at the time of its scan, a loop edge at that of its later
    node; everything is shown at its final pose.
    """
    check_installed()
    import rerun as rr

    if not len(trajectory):
        raise MapmendError(f"{name} holds no scan to replay")
    stream = rr.RecordingStream("mapmend", recording_id=str(uuid4()))
    stream.send_recording_name(name)
    first_s = float(trajectory.stamps_s[0])
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    _log_map(stream, grid)
    _send_robot(stream, trajectory, first_s)
    if graph.stamps_s is not None:
        times = graph.stamps_s - first_s
        _send_nodes(stream, graph, times, np.isin(graph.ids, key_nodes))
        _send_scans(stream, graph, times)
        _send_loops(stream, graph, times)
    return Recording(stream, _blueprint(trajectory))


def rrd_bytes(recording: Recording) -> bytes:
    """The content of an ``.rrd`` file, for rerun."""
    memory = recording.stream.memory_recording()
    recording.stream.send_blueprint(recording.blueprint)
    return memory.drain_as_bytes()


def show(recording: Recording) -> None:
    """Opens rerun's own window."""
    recording.stream.spawn()
    recording.stream.send_blueprint(recording.blueprint)
    recording.stream.flush()


def _blueprint(trajectory: Trajectory) -> Blueprint:
    """The world from above, the strain of loops below it, and the whole drive within a minute."""
    import rerun.blueprint as rrb

    low, high = trajectory.poses[:, :2].min(axis=0), trajectory.poses[:, :2].max(axis=0)
    x, y = 0.5 * (low + high)
    height = EYE_HEIGHT * float((high - low).max() + ROOM_M)
    above = rrb.EyeControls3D(position=(x, y, height), look_target=(x, y, 0.0), eye_up=(0.0, 1.0, 0.0))
    speed = max(1.0, float(np.ptp(trajectory.stamps_s)) / REPLAY_S)

    so_far = rrb.VisibleTimeRanges(
        timeline=TIME, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    world = rrb.Spatial3DView(
        origin="world",
        name="map",
        overrides=dict.fromkeys(GROWING, so_far),
        line_grid=False,
        background=UNKNOWN_COLOUR,
        eye_controls=above,
    )
    strain = rrb.TimeSeriesView(origin=CHI2, name="chi2 of loop edges as they close")
    panel = rrb.TimePanel(state="collapsed", timeline=TIME, playback_speed=round(speed, 1))
    return rrb.Blueprint(rrb.Vertical(world, strain, row_shares=(5, 1)), panel, collapse_panels=True)


def _log_map(stream: RecordingStream, grid: OccupancyMap) -> None:
    """The whole map, from the first moment on, as the background of the replay."""
    import rerun as rr
    from rerun.datatypes import ChannelDatatype, ColorModel, ImageFormat

    palette = np.tile(np.array(UNKNOWN_COLOUR, np.uint8), (256, 1))
    palette[FREE], palette[OCCUPIED] = FREE_COLOUR, OCCUPIED_COLOUR
    # Pictures have their highest row first.
    picture = palette[grid.image[::-1]]
    rows, columns = grid.image.shape
    layout = ImageFormat(columns, rows, color_model=ColorModel.RGB, channel_datatype=ChannelDatatype.U8)
    corner = (grid.origin[0], grid.origin[1], 0.0)
    turn = rr.RotationAxisAngle((0.0, 0.0, 1.0), radians=grid.origin[2])
    cells = rr.GridMap(
        data=picture.tobytes(),
        format=layout,
        cell_size=grid.resolution_m,
        translation=corner,
        rotation_axis_angle=turn,
    )
    stream.log(MAP, cells, static=True)


def _send_robot(stream: RecordingStream, trajectory: Trajectory, first_s: float) -> None:
    """The robot's pose at every scan, and the piece of its path since the scan before."""
    import rerun as rr

    times = [rr.TimeColumn(TIME, duration=trajectory.stamps_s - first_s)]
    poses = trajectory.poses
    places = _lifted(poses[:, :2])
    half = 0.5 * poses[:, 2]
    turns = np.column_stack((np.zeros((len(poses), 2)), np.sin(half), np.cos(half)))
    stream.send_columns(ROBOT, times, rr.Transform3D.columns(translation=places, quaternion=turns))
    arrow = rr.Arrows3D(origins=[(0.0, 0.0, LIFT_M)], vectors=[(ROBOT_M, 0.0, 0.0)], colors=[TRAJECTORY_COLOUR])
    stream.log(f"{ROBOT}/heading", arrow, static=True)
    pieces = np.stack((places[np.maximum(np.arange(len(places)) - 1, 0)], places), axis=1)
    stream.send_columns(TRAJECTORY, times, rr.LineStrips3D.columns(strips=list(pieces)))
    stream.log(TRAJECTORY, rr.LineStrips3D.from_fields(colors=[TRAJECTORY_COLOUR], radii=[TRAJECTORY_M]), static=True)


def _send_nodes(stream: RecordingStream, graph: PoseGraph, times: Float, is_key: NDArray[np.bool_]) -> None:
    import rerun as rr

    for path, rows, colour, radius_m in (
        (NODES, np.flatnonzero(~is_key), NODE_COLOUR, 0.04),
        (KEY_NODES, np.flatnonzero(is_key), KEY_COLOUR, 0.1),
    ):
        places = _lifted(graph.poses[rows, :2])
        if not len(places):
            continue
        columns = rr.Points3D.columns(positions=places, labels=[f"node {name}" for name in graph.ids[rows]])
        stream.send_columns(path, [rr.TimeColumn(TIME, duration=times[rows])], columns)
        stream.log(path, rr.Points3D.from_fields(colors=[colour], radii=[radius_m], show_labels=False), static=True)


def _send_scans(stream: RecordingStream, graph: PoseGraph, times: Float) -> None:
    """The ends of each node's beams, in the map."""
    import rerun as rr

    if graph.scans is None:
        return
    points = [_scan_in_map(graph.scans, k, graph.poses[k]) for k in range(len(graph))]
    columns = rr.Points3D.columns(positions=_lifted(np.concatenate(points))).partition([len(p) for p in points])
    stream.send_columns(SCAN, [rr.TimeColumn(TIME, duration=times)], columns)
    stream.log(SCAN, rr.Points3D.from_fields(colors=[SCAN_COLOUR], radii=[0.03]), static=True)


def _scan_in_map(scans: Scans, row: int, pose: Float) -> Float:
    geometry = scans.geometry_of(row)
    ranges = scans.ranges_of(row).astype(np.float64)
    bearings = geometry.bearings_rad()[: len(ranges)]
    seen = np.isfinite(ranges) & (ranges < geometry.max_range_m)
    ends = (ranges[:, None] * np.stack((np.cos(bearings), np.sin(bearings)), axis=1))[seen]
    return transform_points(pose, transform_points(np.array(geometry.T_robot_laser), ends))


def _send_loops(stream: RecordingStream, graph: PoseGraph, times: Float) -> None:
    """Loop edges, those beyond the chi-square quantile in red, and their chi2 in the finished map."""
    import rerun as rr

    rows = np.flatnonzero(graph.is_loop)
    rows = rows[np.argsort(times[graph.edges[rows]].max(axis=1), kind="stable")]
    if not len(rows):
        return
    chi2 = edge_chi2(graph)[rows]
    ends = _lifted(graph.poses[graph.edges[rows]][:, :, :2].reshape(-1, 2)).reshape(-1, 2, 3)
    colours = np.where((chi2 > USUAL_CHI2)[:, None], STRAINED_COLOUR, LOOP_COLOUR).astype(np.uint8)
    index = [rr.TimeColumn(TIME, duration=times[graph.edges[rows]].max(axis=1))]
    names = [f"{i} - {j}, chi2 {value:.1f}" for (i, j), value in zip(graph.ids[graph.edges[rows]], chi2, strict=True)]
    stream.send_columns(LOOPS, index, rr.LineStrips3D.columns(strips=list(ends), colors=colours, labels=names))
    stream.log(LOOPS, rr.LineStrips3D.from_fields(radii=[0.015], show_labels=False), static=True)
    stream.send_columns(CHI2, index, rr.Scalars.columns(scalars=chi2))
    dots = rr.SeriesPoints(colors=[STRAINED_COLOUR], markers="circle", marker_sizes=[2.0], names=["chi2"])
    stream.log(CHI2, dots, static=True)


def _lifted(places: Float) -> Float:
    """Points (n, 2) a little above the map, (n, 3)."""
    return np.column_stack((places, np.full(len(places), LIFT_M)))
