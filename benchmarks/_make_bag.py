"""Writes one of the bags of `bags.py`: its name says which."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mapmend.io.bags.messages import ODOMETRY_TYPE, SCAN_TYPE
from mapmend.io.bags.write import Messages, nanoseconds, write_bag
from mapmend.io.carmen import read_carmen
from mapmend.scan import LaserGeometry, ScanLog
from mapmend.simulation import LaserModel, corridor_loop, simulate

IMAGE_TYPE = "sensor_msgs/msg/Image"
IMAGE_SIDE = 160


def main() -> None:
    log_file, path, gigabytes = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    if path.name == "stops":
        _write(path, *with_stops(gigabytes), images=0)
        return
    log = read_carmen(log_file)
    if path.name == "camera":
        images = max(round(gigabytes * 1e9 / len(log) / (3 * IMAGE_SIDE**2)), 1)
        _write(path, log, [(k, nanoseconds(stamp)) for k, stamp in enumerate(log.stamps_s.tolist())], images=images)
    else:
        write_bag(path, log, "sqlite3" if "sqlite3" in path.name else "mcap")


def with_stops(gigabytes: float) -> tuple[ScanLog, list[tuple[int, int]]]:
    """One lap of the simulated corridor at 40 Hz with a stop at every scan: rows of the log, and their stamps (ns)."""
    geometry = LaserGeometry(1081, -np.deg2rad(135.0), np.deg2rad(0.25), 8.0)
    log = simulate(corridor_loop(), LaserModel(geometry), seed=1).log
    times = round(gigabytes * 1e9 / len(log) / (4 * geometry.beam_count))
    return log, [(k // times, 25_000_000 * k) for k in range(times * len(log))]


def _write(path: Path, log: ScanLog, rows: list[tuple[int, int]], images: int) -> None:
    """Scans and odometry, and the given number of camera images beside each, as an MCAP bag."""
    messages = Messages(get_typestore(Stores.ROS2_HUMBLE))
    kinds = {"/scan": SCAN_TYPE, "/odom": ODOMETRY_TYPE, "/camera": IMAGE_TYPE}
    pixels = np.random.default_rng(0).integers(0, 255, 3 * IMAGE_SIDE**2, dtype=np.uint8)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        known = {topic: writer.add_connection(topic, kind, typestore=messages.store) for topic, kind in kinds.items()}
        now = 0
        for k, stamp in rows:
            for topic, message in _messages(messages, log, k, stamp, [pixels] * images):
                now = max(now + 1, stamp)
                writer.write(known[topic], now, messages.store.serialize_cdr(message, message.__msgtype__))


def _messages(messages: Messages, log: ScanLog, k: int, stamp_ns: int, images: list[Any]) -> Iterator[tuple[str, Any]]:
    kind, side = messages.store.types[IMAGE_TYPE], IMAGE_SIDE
    for pixels in images:
        yield "/camera", kind(messages.header(stamp_ns, "camera"), side, side, "rgb8", 0, 3 * side, pixels)
    yield "/odom", messages.odometry(stamp_ns, log.odometry[k])
    yield "/scan", messages.scan(stamp_ns, "base_link", log, k)


if __name__ == "__main__":
    main()
