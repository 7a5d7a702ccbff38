"""A log into a ROS 2 bag, as a robot would have recorded it: /scan, /odom, /tf and /tf_static."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mapmend.errors import MapmendError, OutputError
from mapmend.geometry.se2 import Array
from mapmend.io.bags.container import EXTRA
from mapmend.io.bags.messages import NANOSECONDS, ODOMETRY_TYPE, SCAN_TYPE, TRANSFORM_TYPE
from mapmend.io.formats import BAG_FILE
from mapmend.io.output import made_beside, move_file, move_folder
from mapmend.scan import ScanLog

MCAP, SQLITE = "mcap", "sqlite3"
ODOMETRY_FRAME, ROBOT_FRAME, LASER_FRAME = "odom", "base_link", "laser"
_GEOMETRY = "geometry_msgs/msg/"
_LATEST_S = 2**31 - 1


def write_bag(target: str | Path, log: ScanLog, storage: str = MCAP) -> None:
    """Write a log as a ROS 2 bag: a folder, or one file where ``target`` ends in ``.mcap``. Raises OutputError.

    Each scan has an odometry message and a transform with its stamp. Replaces a file, but only an empty folder.
    """
    place = Path(target)
    _check(place, log)
    with made_beside(place) as temporary:
        folder = temporary / place.name
        _write(folder, log, storage)
        if place.suffix == BAG_FILE:
            move_file(next(folder.glob(f"*{BAG_FILE}")), place)
        else:
            move_folder(folder, place)


def _check(place: Path, log: ScanLog) -> None:
    if place.is_dir() and any(place.iterdir()):
        raise OutputError(f"{place}: is there already; name a new folder for the bag")
    if place.is_dir() == (place.suffix == BAG_FILE) and place.exists():
        raise OutputError(f"{place}: is there already, and is a {'folder' if place.is_dir() else 'file'}; name another")
    if len(log) and not (log.stamps_s.min() >= 0.0 and log.stamps_s.max() < _LATEST_S):
        raise OutputError(f"{place}: a bag's stamps run from 0 to {_LATEST_S} s; the log's do not")


def _write(folder: Path, log: ScanLog, storage: str) -> None:
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise MapmendError(f"{str(error.name).split('.', 1)[0]} is not installed; {EXTRA}") from None
    messages = Messages(get_typestore(Stores.ROS2_HUMBLE))
    plugin = StoragePlugin.MCAP if storage == MCAP else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        topics = {"/scan": SCAN_TYPE, "/tf_static": TRANSFORM_TYPE}
        if log.has_odometry:
            topics |= {"/odom": ODOMETRY_TYPE, "/tf": TRANSFORM_TYPE}
        known = {topic: writer.add_connection(topic, kind, typestore=messages.store) for topic, kind in topics.items()}
        recorded_ns = 0
        for topic, stamp_ns, message in _messages(messages, log):
            # Recorders write messages in the order of arrival; their stamps may go back.
            recorded_ns = max(recorded_ns + 1, stamp_ns)
            writer.write(known[topic], recorded_ns, messages.store.serialize_cdr(message, message.__msgtype__))


def _messages(messages: Messages, log: ScanLog) -> Iterator[tuple[str, int, Any]]:
    """All messages in the order of recording: topic, stamp, content."""
    frames = _laser_frames(log)
    stamps = [nanoseconds(stamp) for stamp in log.stamps_s.tolist()]
    first = stamps[0] if stamps else 0
    mounts = [messages.transform(first, ROBOT_FRAME, frame, np.array(pose)) for pose, frame in frames.items()]
    yield "/tf_static", first, messages.transforms(mounts)
    for k, stamp in enumerate(stamps):
        if log.has_odometry:
            pose = log.odometry[k]
            yield "/odom", stamp, messages.odometry(stamp, pose)
            yield "/tf", stamp, messages.transforms([messages.transform(stamp, ODOMETRY_FRAME, ROBOT_FRAME, pose)])
        yield "/scan", stamp, messages.scan(stamp, frames[log.scans.geometry_of(k).T_robot_laser], log, k)


def _laser_frames(log: ScanLog) -> dict[tuple[float, float, float], str]:
    """A frame for each mounting of a laser."""
    mountings = dict.fromkeys(geometry.T_robot_laser for geometry in log.scans.geometries)
    return {pose: LASER_FRAME if k == 0 else f"{LASER_FRAME}_{k + 1}" for k, pose in enumerate(mountings)}


class Messages:
    """Makes messages of rosbags' types."""

    def __init__(self, store: Any) -> None:
        self.store = store
        self._types = store.types
        zero = self._types[_GEOMETRY + "Vector3"](0.0, 0.0, 0.0)
        twist = self._types[_GEOMETRY + "Twist"](zero, zero)
        self._no_twist = self._types[_GEOMETRY + "TwistWithCovariance"](twist, np.zeros(36))

    def scan(self, stamp_ns: int, frame: str, log: ScanLog, k: int) -> Any:
        geometry, ranges = log.scans.geometry_of(k), np.ascontiguousarray(log.scans.ranges_of(k))
        first, step = geometry.first_angle_rad, geometry.angle_increment_rad
        last, most = first + step * max(geometry.beam_count - 1, 0), geometry.max_range_m
        nothing = np.zeros(0, np.float32)
        header = self.header(stamp_ns, frame)
        return self._types[SCAN_TYPE](header, first, last, step, 0.0, 0.0, 0.0, most, ranges, nothing)

    def odometry(self, stamp_ns: int, pose: Array) -> Any:
        position = self._types[_GEOMETRY + "Point"](float(pose[0]), float(pose[1]), 0.0)
        where = self._types[_GEOMETRY + "Pose"](position, self._turn(pose))
        with_covariance = self._types[_GEOMETRY + "PoseWithCovariance"](where, np.zeros(36))
        header = self.header(stamp_ns, ODOMETRY_FRAME)
        return self._types[ODOMETRY_TYPE](header, ROBOT_FRAME, with_covariance, self._no_twist)

    def transform(self, stamp_ns: int, parent: str, child: str, pose: Array) -> Any:
        place = self._types[_GEOMETRY + "Vector3"](float(pose[0]), float(pose[1]), 0.0)
        motion = self._types[_GEOMETRY + "Transform"](place, self._turn(pose))
        return self._types[_GEOMETRY + "TransformStamped"](self.header(stamp_ns, parent), child, motion)

    def transforms(self, transforms: list[Any]) -> Any:
        return self._types[TRANSFORM_TYPE](transforms)

    def _turn(self, pose: Array) -> Any:
        half = 0.5 * float(pose[2])
        return self._types[_GEOMETRY + "Quaternion"](0.0, 0.0, float(np.sin(half)), float(np.cos(half)))

    def header(self, stamp_ns: int, frame: str) -> Any:
        time = self._types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NANOSECONDS))
        return self._types["std_msgs/msg/Header"](time, frame)


def nanoseconds(stamp_s: float) -> int:
    """The whole nanoseconds nearest to a double; `mapmend.io.bags.read.seconds` gives the same double again."""
    return round(Fraction(stamp_s) * NANOSECONDS)
