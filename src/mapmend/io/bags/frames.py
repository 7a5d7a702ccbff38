"""The tree of frames in a bag: which are connected, which move, and where a laser is mounted on its robot."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.io.bags.messages import Transform, yaw_of

Float = NDArray[np.float64]

_SAME_M, _SAME_RAD = 1e-3, 1e-3
_ROBOT_FRAMES = ("base_footprint", "base_link", "base")  # REP-105's names, used if the odometry names no frame


class UnknownFrameError(MapmendError):
    """Two frames without a chain of transforms between them."""


class MovingFrameError(MapmendError):
    """A frame that moves where it should be fixed to another."""


@dataclass
class Joint:
    """One edge of the tree. A constant transform is kept once, a moving one as x, y and yaw over time."""

    parent: str
    child: str
    first: tuple[float, ...]
    first_ns: int
    last_ns: int
    moves: bool = False
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, stamp_ns: int, numbers: tuple[float, ...]) -> None:
        """Takes one more transform."""
        if not self.stamps_ns:
            if numbers == self.first:
                self.last_ns = stamp_ns
                return
            for known_ns in (self.first_ns, self.last_ns):
                self.stamps_ns.append(known_ns)
                self.values.extend((*self.first[:2], *self.first[3:]))
        self.stamps_ns.append(stamp_ns)
        self.values.extend((*numbers[:2], *numbers[3:]))
        self.moves = self.moves or _differs(self.first, numbers)

    def series(self) -> tuple[NDArray[np.int64], Float]:
        """Stamps (ns), shape (m,), and planar poses, shape (m, 3)."""
        if not self.stamps_ns:
            rows = np.array([(*self.first[:2], *self.first[3:])] * 2)
            return np.array((self.first_ns, self.last_ns)), planar(rows)
        rows = np.frombuffer(self.values, np.float64).reshape(-1, 6)
        return np.frombuffer(self.stamps_ns, np.int64), planar(rows)


@dataclass(frozen=True)
class Mounting:
    """A laser on its robot, in the plane: a laser that is mounted upside down scans in the opposite direction."""

    pose: tuple[float, float, float]
    upside_down: bool
    tilt_rad: float


class Frames:
    """All transforms of a bag, by the child's frame."""

    def __init__(self) -> None:
        self.joints: dict[str, Joint] = {}
        self.rivals: set[tuple[str, str]] = set()
        self.unusable = 0

    def __contains__(self, frame: str) -> bool:
        return frame in self.joints or any(joint.parent == frame for joint in self.joints.values())

    def names(self) -> list[str]:
        return sorted({*self.joints, *(joint.parent for joint in self.joints.values())})

    def add(self, transform: Transform) -> None:
        """Takes one more transform; a frame's first parent stays its parent."""
        joint = self.joints.get(transform.child)
        if not math.isfinite(sum(transform.numbers)):
            self.unusable += 1
        elif joint is None:
            stamp = transform.stamp_ns
            self.joints[transform.child] = Joint(transform.parent, transform.child, transform.numbers, stamp, stamp)
        elif joint.parent != transform.parent:
            self.rivals.add((transform.parent, transform.child))
        else:
            joint.add(transform.stamp_ns, transform.numbers)

    def ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root."""
        chain = [frame]
        while (joint := self.joints.get(chain[-1])) is not None and joint.parent not in chain:
            chain.append(joint.parent)
        return chain

    def odometry_joint(self, frame: str) -> Joint | None:
        """The edge above ``frame`` that holds the robot's motion: the one below a frame called odom, otherwise the
        lowest that moves; None if there is none."""
        above = [self.joints[name] for name in self.ancestors(frame) if name in self.joints]
        named = [joint for joint in above if "odom" in joint.parent.lower()]
        return next(iter(named + [joint for joint in above if joint.moves]), None)

    def robot_frame(self) -> str | None:
        """The frame with a usual name for a robot; None if there is none."""
        return next((name for name in _ROBOT_FRAMES if name in self), None)

    def fixed(self, target: str, source: str) -> Float:
        """``T_target_source``, shape (4, 4); raises UnknownFrameError, and MovingFrameError if a part of it moves."""
        up, down = self.ancestors(target), self.ancestors(source)
        meeting = next((name for name in up if name in down), None)
        if meeting is None:
            raise UnknownFrameError(f"no transform leads from frame '{target}' to '{source}'")
        return np.asarray(np.linalg.inv(self._climb(up, meeting)) @ self._climb(down, meeting))

    def _climb(self, chain: list[str], to: str) -> Float:
        T = np.eye(4)
        for name in chain[: chain.index(to)]:
            joint = self.joints[name]
            if joint.moves:
                raise MovingFrameError(f"frame '{joint.child}' moves relative to '{joint.parent}'")
            T = _matrix(joint.first) @ T
        return T


def mounting_of(T_robot_laser: Float) -> Mounting:
    """A laser's 3D pose, shape (4, 4), in the plane."""
    rotation = T_robot_laser[:3, :3]
    tilt = float(np.arccos(np.clip(abs(rotation[2, 2]), 0.0, 1.0)))
    # The product of three rotations has a rounding error; a mounting has no 13th digit.
    x, y, yaw = np.round((*T_robot_laser[:2, 3], np.arctan2(rotation[1, 0], rotation[0, 0])), 12).tolist()
    yaw = float(np.copysign(np.pi, yaw)) if abs(abs(yaw) - np.pi) < 1e-11 else yaw
    return Mounting((x + 0.0, y + 0.0, yaw + 0.0), bool(rotation[2, 2] < 0.0), tilt)


def planar(rows: Float) -> Float:
    """x, y and yaw, shape (m, 3), of rows ``x y qx qy qz qw``."""
    return np.column_stack((rows[:, :2], yaw_of(rows[:, 2:])))


def plane_pose(T: Float) -> tuple[float, float, float]:
    """x, y and yaw of a 3D pose, shape (4, 4)."""
    return float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0]))


def _differs(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """Whether two transforms differ by more than their rounding."""
    if max(abs(p - q) for p, q in zip(a[:3], b[:3], strict=True)) > _SAME_M:
        return True
    same = abs(sum(p * q for p, q in zip(a[3:], b[3:], strict=True)))
    return bool(same < np.cos(0.5 * _SAME_RAD))


def _matrix(numbers: tuple[float, ...]) -> Float:
    """A translation and a quaternion ``x y z w`` as a matrix; a quaternion of length zero is no rotation."""
    x, y, z, w = numbers[3:]
    T = np.eye(4)
    T[:3, 3] = numbers[:3]
    length = x * x + y * y + z * z + w * w
    if length > 0.0:
        s = 2.0 / length
        T[:3, :3] = (
            (1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
            (s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
            (s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
        )
    return T
