"""Trajectories as the TUM benchmark and evo write them: ``stamp x y z qx qy qz qw``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapmend.errors import InputError, MapmendError
from mapmend.io._decimals import Float
from mapmend.io.columns import read_columns
from mapmend.io.files import read_bytes
from mapmend.io.output import write_whole
from mapmend.trajectory import Trajectory

_FIELDS = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_LEAST_DECIMALS = 6


def read_tum(path: str | Path) -> Trajectory:
    """Read a trajectory; of a 3D pose, the position in the plane and the yaw are kept. Raises InputError."""
    return parse_tum(read_bytes(path), path)


def parse_tum(data: bytes, path: str | Path) -> Trajectory:
    """The same for bytes already read; ``path`` is for messages."""
    values, lines = read_columns(data, _FIELDS, path)
    qx, qy, qz, qw = values[:, 4:].T
    norm = np.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    wrong = np.abs(norm - 1.0) > 1e-2
    if wrong.any():
        k = int(np.argmax(wrong))
        what = f"the quaternion's length is {norm[k]:g}, not 1"
        raise InputError(path, what, "give the fields as stamp x y z qx qy qz qw", int(lines[k]))
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return Trajectory(values[:, 0].copy(), np.column_stack((values[:, 1], values[:, 2], yaw)))


def write_tum(path: str | Path, stamps_s: Float, poses: Float) -> None:
    """Write poses (n, 3) at stamps (n,), both to the last bit (the yaw to rounding); raises OutputError."""
    if stamps_s.shape != (len(poses),) or poses.shape != (len(stamps_s), 3):
        raise MapmendError(f"stamps_s must be (n,) and poses (n, 3), got {stamps_s.shape} and {poses.shape}")
    half = 0.5 * poses[:, 2]
    rows = np.column_stack((poses[:, :2], np.sin(half), np.cos(half))).tolist()
    lines = [
        f"{stamp_text(t)} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}\n"
        for t, (x, y, qz, qw) in zip(stamps_s.tolist(), rows, strict=True)
    ]
    write_whole(path, "".join(lines))


def stamp_text(stamp_s: float) -> str:
    """A stamp with six decimals, or with as many more as it needs."""
    short = f"{stamp_s:.{_LEAST_DECIMALS}f}"
    return short if float(short) == stamp_s else np.format_float_positional(stamp_s, min_digits=_LEAST_DECIMALS)
