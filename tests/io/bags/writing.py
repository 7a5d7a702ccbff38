"""Bags of all kinds from a log, written by rosbags with its own message types: what mapmend must read."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("ros1", "sqlite3", "mcap", "bare mcap")
SCAN, ODOMETRY, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class BagWriter:
    """Writes messages into one bag; ``kind`` is one of KINDS. Times of recording rise whatever the stamps do."""

    def __init__(self, path: Path, kind: str, packing: str | None = None):
        self.ros1 = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        self.bare = kind == "bare mcap"
        folder = path.with_name(path.name + ".folder") if self.bare else path
        plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
        self.writer = Writer1(path) if self.ros1 else Writer2(folder, version=9, storage_plugin=plugin)
        if packing == "zstd":
            self.writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        elif packing:
            self.writer.set_compression(Writer1.CompressionFormat[packing.upper()])
        self.path, self.folder, self.connections, self.now = path, folder, {}, 0

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *error):
        self.writer.close()
        if self.bare:
            next(self.folder.glob("*.mcap")).rename(self.path)

    def write(self, topic, message, stamp_ns):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, message.__msgtype__, typestore=self.store)
        self.now = max(self.now + 1, stamp_ns)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], self.now, serialize(message, message.__msgtype__))

    def make(self, name, *values):
        return self.store.types[name](*values)

    def header(self, stamp_ns, frame):
        time = self.make("builtin_interfaces/msg/Time", *divmod(int(stamp_ns), 10**9))
        return self.make("std_msgs/msg/Header", *((0,) if self.ros1 else ()), time, frame)

    def scan(self, stamp_ns, frame, ranges, first, step, *, range_max, range_min=0.0, time_increment=0.0):
        last = first + step * (len(ranges) - 1)
        values = np.ascontiguousarray(ranges, np.float32), np.zeros(0, np.float32)
        header = self.header(stamp_ns, frame)
        return self.make(SCAN, header, first, last, step, time_increment, 0.1, range_min, range_max, *values)

    def odometry(self, stamp_ns, pose, frame="odom", child="base_link"):
        position, turn = self._pose(pose)
        geometry = "geometry_msgs/msg/"
        zero = self.make(geometry + "Vector3", 0.0, 0.0, 0.0)
        with_covariance = self.make(
            geometry + "PoseWithCovariance", self.make(geometry + "Pose", position, turn), np.zeros(36)
        )
        twist = self.make(geometry + "TwistWithCovariance", self.make(geometry + "Twist", zero, zero), np.zeros(36))
        return self.make(ODOMETRY, self.header(stamp_ns, frame), child, with_covariance, twist)

    def transform(self, stamp_ns, parent, child, pose, roll=0.0):
        position, turn = self._pose(pose, roll)
        vector = self.make("geometry_msgs/msg/Vector3", position.x, position.y, position.z)
        motion = self.make("geometry_msgs/msg/Transform", vector, turn)
        one = self.make("geometry_msgs/msg/TransformStamped", self.header(stamp_ns, parent), child, motion)
        return self.make(TF, [one])

    def _pose(self, pose, roll=0.0):
        """A place on the plane, turned by yaw after roll."""
        x, y, yaw = map(float, pose)
        c, s, cr, sr = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(roll / 2), np.sin(roll / 2)
        turn = self.make("geometry_msgs/msg/Quaternion", float(c * sr), float(s * sr), float(s * cr), float(c * cr))
        return self.make("geometry_msgs/msg/Point", x, y, 0.0), turn


@dataclass
class Layout:
    """What the bag of a log looks like. ``odometry``: "topic", "tf" or None."""

    odometry: str | None = "topic"
    static: bool = True
    upside_down: bool = False
    clockwise: bool = False
    scan_topics: tuple[str, ...] = ("/scan",)


def write_bag_of(path, kind, log, layout=None):
    """The log's scans with an odometry message each, of the scan's stamp, and the mounting of the laser."""
    layout = layout or Layout()
    with BagWriter(path, kind) as bag:
        stamps = [nanoseconds(t) for t in log.stamps_s.tolist()]
        if layout.static:
            mounting = log.scans.geometries[0].T_robot_laser
            roll = np.pi if layout.upside_down else 0.0
            bag.write("/tf_static", bag.transform(stamps[0], "base_link", "laser", mounting, roll), stamps[0])
        for k, stamp in enumerate(stamps):
            if layout.odometry == "topic":
                bag.write("/odom", bag.odometry(stamp, log.odometry[k]), stamp)
            elif layout.odometry == "tf":
                bag.write("/tf", bag.transform(stamp, "odom", "base_link", log.odometry[k]), stamp)
            for topic in layout.scan_topics:
                bag.write(topic, scan_of(bag, stamp, log, k, layout), stamp)
    return path


def scan_of(bag, stamp, log, k, layout):
    geometry, ranges = log.scans.geometry_of(k), log.scans.ranges_of(k)
    first, step = geometry.first_angle_rad, geometry.angle_increment_rad
    if layout.upside_down != layout.clockwise:  # either turns the order of the beams round
        ranges = ranges[::-1]
    if layout.clockwise:
        first, step = first + step * (len(ranges) - 1), -step
    if layout.upside_down:
        first = -(first + step * (len(ranges) - 1))
    return bag.scan(stamp, "laser", ranges, first, step, range_max=geometry.max_range_m)


def nanoseconds(stamp_s: float) -> int:
    return round(Fraction(stamp_s) * 10**9)
