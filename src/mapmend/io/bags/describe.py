"""What a bag holds: topics with their rates and gaps, frames and which of them move."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapmend.io.bags.container import Bag, open_bag
from mapmend.io.bags.frames import Frames
from mapmend.io.bags.messages import BadMessageError, transform_messages
from mapmend.io.bags.read import TF_TYPES


@dataclass
class Times:
    """The times at which the messages of a topic were recorded."""

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_ns: int = 0

    def add(self, time_ns: int) -> None:
        if self.count:
            self.longest_gap_ns = max(self.longest_gap_ns, time_ns - self.last_ns)
        else:
            self.first_ns = time_ns
        self.last_ns = time_ns
        self.count += 1

    def rate_hz(self) -> float | None:
        """Messages per second; None for fewer than two messages, or if all have the same time."""
        duration_s = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / duration_s if duration_s > 0.0 else None


def describe_bag(path: str | Path) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Facts, ready for JSON, and notes on what is odd; raises InputError for a bag that cannot be opened."""
    with open_bag(path) as bag:
        times, frames = _walk(bag)
        topics = [_topic(bag, name, times[name]) for name in bag.topics]
        facts: dict[str, Any] = {"container": bag.kind, "topics": topics, "frames": _frames(frames)}
        notes = tuple(map(str, bag.notes)) + tuple(
            f"frame '{child}' has two parents, '{frames.joints[child].parent}' and '{parent}'"
            for parent, child in sorted(frames.rivals)
        )
    return facts, notes


def _walk(bag: Bag) -> tuple[dict[str, Times], Frames]:
    times, frames = {name: Times() for name in bag.topics}, Frames()
    transforms = {topic.name for topic in bag.topics.values() if topic.type in TF_TYPES}
    for topic, time_ns, raw in bag.messages(list(bag.topics)):
        times[topic].add(time_ns)
        if topic in transforms:
            try:
                for transform in transform_messages(raw, bag.is_ros1):
                    frames.add(transform)
            except BadMessageError:
                continue
    return times, frames


def _topic(bag: Bag, name: str, times: Times) -> dict[str, Any]:
    rate = times.rate_hz()
    return {
        "name": name,
        "type": bag.topics[name].type,
        "messages": times.count,
        "rate_hz": None if rate is None else round(rate, 3),
        "longest_gap_s": round(times.longest_gap_ns * 1e-9, 3) if times.count > 1 else None,
    }


def _frames(frames: Frames) -> list[dict[str, Any]]:
    rows = []
    for joint in frames.joints.values():
        numbers = [float(np.round(value, 9)) for value in joint.first]
        row = {"parent": joint.parent, "child": joint.child, "moves": joint.moves}
        rows.append({**row, "translation_m": numbers[:3], "quaternion_xyzw": numbers[3:]})
    return sorted(rows, key=lambda row: (str(row["parent"]), str(row["child"])))


def topic_line(topic: dict[str, Any]) -> str:
    """One topic as text."""
    rate, gap = topic["rate_hz"], topic["longest_gap_s"]
    speed = "" if rate is None else f", {rate:.1f} Hz, longest gap {gap:.2f} s"
    return f"  topic: {topic['name']} ({topic['type']}), {topic['messages']} messages{speed}"


def frame_line(frame: dict[str, Any]) -> str:
    """One transform as text."""
    if frame["moves"]:
        return f"  frame: {frame['parent']} -> {frame['child']}, moves"
    x, y, z = frame["translation_m"]
    qx, qy, qz, qw = frame["quaternion_xyzw"]
    yaw = np.rad2deg(np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz))
    below = ", upside down" if qw * qw + qz * qz < qx * qx + qy * qy else ""
    return f"  frame: {frame['parent']} -> {frame['child']}, at x {x:g} m, y {y:g} m, z {z:g} m, {yaw:g} deg{below}"
