"""From a bag to a log: choose topics, collect scans, odometry and frames in one pass, find the laser's mounting."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import InputError, MapmendError
from mapmend.geometry.se2 import compose
from mapmend.io.bags.container import Bag, Topic, open_bag
from mapmend.io.bags.deskew import deskewed
from mapmend.io.bags.frames import (
    Frames,
    Mounting,
    MovingFrameError,
    UnknownFrameError,
    mounting_of,
    planar,
    plane_pose,
)
from mapmend.io.bags.messages import (
    NANOSECONDS,
    ODOMETRY_TYPE,
    OLD_TRANSFORM_TYPE,
    SCAN_TYPE,
    TRANSFORM_TYPE,
    BadMessageError,
    laser_message,
    odometry_message,
    transform_messages,
)
from mapmend.io.bags.odometry import OdometrySeries
from mapmend.io.bags.options import BagOptions
from mapmend.io.bags.sweeps import Sweeps
from mapmend.parallel import Progress, no_progress
from mapmend.scan import Note, ScanLog

Float = NDArray[np.float64]
Int = NDArray[np.int64]

TF_TYPES = (TRANSFORM_TYPE, OLD_TRANSFORM_TYPE)
TF = "/tf"
_MOST_NAMES = 12
_TOLD_EVERY = 1000  # messages
_FAR_OUTSIDE_S = 0.2  # two messages of a slow odometry
_OTHER_CLOCK_S = 10.0
_TILT_RAD, _MOST_TILT_RAD = np.deg2rad(3.0), np.deg2rad(30.0)


@dataclass
class Gathered:
    """The result of one pass over the messages."""

    sweeps: Sweeps
    frames: Frames = field(default_factory=Frames)
    odometry_ns: array[int] = field(default_factory=lambda: array("q"))
    odometry_received_ns: array[int] = field(default_factory=lambda: array("q"))
    odometry: array[float] = field(default_factory=lambda: array("d"))  # x y qx qy qz qw
    odometry_child: str = ""
    bad: int = 0


def read_bag(
    path: str | Path, options: BagOptions | None = None, lenient: bool = False, progress: Progress = no_progress
) -> ScanLog:
    """The log in a bag; raises InputError that says what is wrong and what to choose.

    ``lenient`` leaves out messages that cannot be decoded.
    """
    chosen = options or BagOptions()
    with open_bag(path) as bag:
        scan_topic = choose_scan_topic(bag, chosen)
        odometry_topic = choose_odometry_topic(bag, chosen)
        gathered = gather(bag, scan_topic, odometry_topic, lenient, progress)
    if not len(gathered.sweeps):
        raise InputError(path, f"no scan can be read on {scan_topic}", "name a bag with laser scans")
    try:
        return _assemble(gathered, bag, odometry_topic, chosen)
    except InputError:
        raise
    except (UnknownFrameError, MovingFrameError) as error:
        raise InputError(path, str(error), "choose the robot's frame with --base-frame") from None
    except MapmendError as error:
        raise InputError(path, str(error)) from None


def choose_scan_topic(bag: Bag, options: BagOptions) -> str:
    """The topic of the laser: the chosen one, or the only one; raises InputError that lists them."""
    found = [topic for topic in bag.topics.values() if topic.type == SCAN_TYPE and topic.count]
    if not found and options.scan_topic is None:
        what = f"holds no sensor_msgs/LaserScan; it holds {_listed(list(bag.topics.values()), types=True)}"
        raise InputError(bag.path, what, "name a bag with laser scans")
    return _choose(bag, found, options.scan_topic, "--scan-topic", "LaserScans").name


def choose_odometry_topic(bag: Bag, options: BagOptions) -> str | None:
    """The topic of the odometry: the chosen one, the only Odometry topic, /tf, or None if there is none of these."""
    found = [topic for topic in bag.topics.values() if topic.type == ODOMETRY_TYPE and topic.count]
    transforms = [topic for topic in bag.topics.values() if topic.type in TF_TYPES and topic.count]
    if options.odom_topic in {topic.name for topic in transforms}:
        return TF
    if found or options.odom_topic is not None:
        return _choose(bag, found, options.odom_topic, "--odom-topic", "Odometry").name
    return TF if transforms else None


def _choose(bag: Bag, found: list[Topic], wanted: str | None, option: str, what: str) -> Topic:
    if wanted is None and len(found) == 1:
        return found[0]
    for topic in found:
        if wanted is not None and topic.name.lstrip("/") == wanted.lstrip("/"):
            return topic
    if wanted is None:
        raise InputError(bag.path, f"{len(found)} topics hold {what}: {_listed(found)}", f"choose one with {option}")
    known = f"there {'is' if len(found) == 1 else 'are'} {_listed(found)}" if found else f"no topic holds {what}"
    raise InputError(bag.path, f"no {what} on {wanted!a}", known)


def _listed(topics: list[Topic], types: bool = False) -> str:
    names = [f"{t.name} ({t.type if types else t.count})" for t in topics[:_MOST_NAMES]]
    rest = [f"{len(topics) - _MOST_NAMES} more"] if len(topics) > _MOST_NAMES else []
    return ", ".join(names + rest) or "nothing"


def gather(bag: Bag, scan_topic: str, odometry_topic: str | None, lenient: bool, progress: Progress) -> Gathered:
    """One pass over the bag: if the container has an index, other topics are not even unpacked."""
    gathered = Gathered(Sweeps(bag.topics[scan_topic].count))
    transforms = {topic.name for topic in bag.topics.values() if topic.type in TF_TYPES}
    names = transforms | {name for name in (scan_topic, odometry_topic) if name in bag.topics}
    total = sum(bag.topics[name].count for name in names)
    with np.errstate(invalid="ignore"):
        for count, (topic, received_ns, raw) in enumerate(bag.messages(names), 1):
            if count % _TOLD_EVERY == 0:
                progress("read", count, total)
            try:
                if topic == scan_topic:
                    gathered.sweeps.add(laser_message(raw, bag.is_ros1), received_ns)
                elif topic in transforms:
                    for transform in transform_messages(raw, bag.is_ros1):
                        gathered.frames.add(transform)
                else:
                    _take_odometry(gathered, received_ns, raw, bag.is_ros1)
            except BadMessageError as error:
                if not lenient:
                    mend = "record it again, or pass --lenient to leave such messages out"
                    raise InputError(bag.path, f"a message on {topic} can't be read: {error}", mend) from None
                gathered.bad += 1
    return gathered


def _take_odometry(gathered: Gathered, received_ns: int, raw: bytes, ros1: bool) -> None:
    pose = odometry_message(raw, ros1)
    if not np.all(np.isfinite(pose.numbers)):
        raise BadMessageError("a pose is not finite")
    gathered.odometry_ns.append(pose.stamp_ns)
    gathered.odometry_received_ns.append(received_ns)
    gathered.odometry.extend((*pose.numbers[:2], *pose.numbers[3:]))
    gathered.odometry_child = gathered.odometry_child or pose.child


def _assemble(gathered: Gathered, bag: Bag, odometry_topic: str | None, options: BagOptions) -> ScanLog:
    notes = list(bag.notes)
    if gathered.bad:
        notes.append(Note("message left out that can't be read", gathered.bad))
    sweeps = gathered.sweeps
    if gathered.frames.unusable:
        notes.append(Note("transform that is not finite, left out", gathered.frames.unusable))
    _check_frame(gathered, bag, options)
    series, robot_frame = _odometry(gathered, odometry_topic, options, notes)
    mountings = _mountings(gathered, robot_frame, notes)
    stamps_ns = _stamps(sweeps, notes)
    scans = sweeps.scans(mountings, notes)
    poses, times_ns = np.zeros((len(scans), 3)), stamps_ns
    if series is not None:
        series, times_ns = _on_one_clock(gathered, series, stamps_ns, notes)
        poses = series.at_scans(times_ns)
        _note_outside(series, times_ns, notes)
    if options.deskew:
        lasers = [(laser, mountings[laser.frame]) for laser in sweeps.lasers]
        scans = deskewed(scans, lasers, times_ns, series, notes)
    _note_steps(stamps_ns, notes)
    return ScanLog(scans, seconds(stamps_ns), poses, True, str(bag.path), tuple(notes), has_odometry=series is not None)


def _check_frame(gathered: Gathered, bag: Bag, options: BagOptions) -> None:
    """Raises InputError if the chosen frame is not in the bag."""
    if options.base_frame is None:
        return
    known = {*gathered.frames.names(), gathered.odometry_child, *(laser.frame for laser in gathered.sweeps.lasers)}
    if options.base_frame.lstrip("/") not in known:
        listed = ", ".join(sorted(known - {""})[:_MOST_NAMES])
        raise InputError(bag.path, f"there is no frame {options.base_frame!a}", f"it knows {listed}")


def _odometry(
    gathered: Gathered, topic: str | None, options: BagOptions, notes: list[Note]
) -> tuple[OdometrySeries | None, str | None]:
    """The robot's poses over time, and the name of its frame."""
    frames = gathered.frames
    wanted = options.base_frame.lstrip("/") if options.base_frame else None
    if topic is not None and topic != TF and gathered.odometry_ns:
        rows = np.frombuffer(gathered.odometry, np.float64).reshape(-1, 6)
        series = OdometrySeries.sorted(np.frombuffer(gathered.odometry_ns, np.int64), planar(rows))
        own = gathered.odometry_child
        lasers = {laser.frame for laser in gathered.sweeps.lasers}
        if own not in frames and own not in lasers and (named := frames.robot_frame()):
            if own:
                notes.append(Note(f"no transform has the odometry's frame '{own}'; it is taken for '{named}'"))
            own = named
    else:
        start = wanted or gathered.sweeps.lasers[0].frame
        joint = frames.odometry_joint(start)
        if joint is None:
            notes.append(Note("no odometry, neither nav_msgs/Odometry nor a moving frame; the laser alone is used"))
            return None, wanted or frames.robot_frame()
        series, own = OdometrySeries.sorted(*joint.series()), joint.child
        if "odom" not in joint.parent.lower():
            notes.append(Note(f"odometry is taken from {TF}: '{joint.parent}' to '{joint.child}'"))
    if wanted is None or own is None or own == wanted:
        return series, wanted or own
    T_own_wanted = plane_pose(frames.fixed(own, wanted))
    return OdometrySeries(series.stamps_ns, compose(series.poses, np.array(T_own_wanted))), wanted


def _mountings(gathered: Gathered, robot_frame: str | None, notes: list[Note]) -> dict[str, Mounting]:
    """The mounting of each laser, by its frame; a laser without transforms is put at the robot's centre, with a
    note."""
    mountings = {}
    for frame in dict.fromkeys(laser.frame for laser in gathered.sweeps.lasers):
        mountings[frame] = Mounting((0.0, 0.0, 0.0), False, 0.0)
        if frame == robot_frame:
            continue
        try:
            if robot_frame is None:
                raise UnknownFrameError(f"no transform gives the place of '{frame}' on the robot")
            mountings[frame] = mounting_of(gathered.frames.fixed(robot_frame, frame))
        except UnknownFrameError as error:
            notes.append(Note(f"{error}; the laser is put at the robot's centre, looking ahead"))
        tilt = mountings[frame].tilt_rad
        if tilt > _MOST_TILT_RAD:
            what = f"laser '{frame}' is tilted by {np.rad2deg(tilt):.0f} degrees against '{robot_frame}'"
            raise MapmendError(f"{what}: its scans are no floor plan; choose another laser with --scan-topic")
        if tilt > _TILT_RAD:
            notes.append(Note(f"laser '{frame}' is tilted by {np.rad2deg(tilt):.1f} degrees, which is left out"))
    return mountings


def _stamps(sweeps: Sweeps, notes: list[Note]) -> Int:
    stamps = np.frombuffer(sweeps.stamps_ns, np.int64)
    if stamps.any():
        return stamps
    notes.append(Note("the scans carry no stamps; the times of recording are used"))
    return np.frombuffer(sweeps.received_ns, np.int64)


def seconds(stamps_ns: Int) -> Float:
    """The double nearest to each time: by one division if the nanoseconds are exact, otherwise seconds separately."""
    whole, rest = np.divmod(stamps_ns, NANOSECONDS)
    return np.where(np.abs(stamps_ns) < 2**53, stamps_ns / NANOSECONDS, whole + rest / NANOSECONDS)


def _on_one_clock(
    gathered: Gathered, series: OdometrySeries, stamps_ns: Int, notes: list[Note]
) -> tuple[OdometrySeries, Int]:
    """The odometry and the scans' times: by their stamps, or by the times of recording where two clocks disagree."""
    if not np.all(series.outside_s(stamps_ns) > _OTHER_CLOCK_S) or not gathered.odometry_ns:
        return series, stamps_ns
    order = np.argsort(np.frombuffer(gathered.odometry_ns, np.int64), kind="stable")
    received = np.frombuffer(gathered.odometry_received_ns, np.int64)[order]
    notes.append(Note("laser and odometry are stamped by different clocks; they are joined by the times of recording"))
    return OdometrySeries.sorted(received, series.poses), np.frombuffer(gathered.sweeps.received_ns, np.int64)


def _note_outside(series: OdometrySeries, stamps_ns: Int, notes: list[Note]) -> None:
    outside = series.outside_s(stamps_ns)
    far = outside > _FAR_OUTSIDE_S
    if far.any():
        what = f"scan outside the odometry's time, by up to {outside.max():.1f} s; it takes the nearest pose"
        notes.append(Note(what, int(far.sum())))


def _note_steps(stamps_ns: Int, notes: list[Note]) -> None:
    steps = np.diff(stamps_ns)
    for what, odd in (("timestamp steps back", steps < 0), ("timestamp repeats the one before", steps == 0)):
        if odd.any():
            notes.append(Note(what, int(odd.sum())))
