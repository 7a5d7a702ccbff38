"""Trajectories in the format of the KITTI odometry benchmark and evo: each line the upper 3 x 4 of a pose's matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapmend.errors import InputError, MapmendError
from mapmend.io._decimals import Float
from mapmend.io.columns import read_columns
from mapmend.io.files import read_bytes
from mapmend.io.output import write_whole

COLUMNS = 12
_NAMES = tuple(f"{row}{column}" for row in ("r1", "r2", "r3") for column in ("1", "2", "3", " translation"))
_OFF_THE_PLANE = 0.1


def read_kitti(path: str | Path) -> Float:
    """Poses x, y, yaw, shape (n, 3), of a file of twelve columns; raises InputError.

    The poses must be in the plane of x and y; those of KITTI's own files are those of a camera that looks along z.
    """
    values, lines = read_columns(read_bytes(path), _NAMES, path)
    rows = values.reshape(-1, 3, 4)
    turns = rows[:, :, :3]
    wrong = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2)) > 1e-2
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(path, "the line holds no rotation", "give the upper three rows of a pose", int(lines[k]))
    tilted = rows[:, 2, 2] < 1.0 - _OFF_THE_PLANE
    if tilted.any():
        what = "the pose is tilted against the plane of x and y"
        mend = "turn a camera's poses first, so that z points up"
        raise InputError(path, what, mend, int(lines[int(np.argmax(tilted))]))
    return np.column_stack((rows[:, 0, 3], rows[:, 1, 3], np.arctan2(rows[:, 1, 0], rows[:, 0, 0])))


def write_kitti(path: str | Path, poses: Float) -> None:
    """Write poses x, y, yaw, shape (n, 3): x forward, z up, as in all of mapmend; raises OutputError."""
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise MapmendError(f"poses must be (n, 3), got {poses.shape}")
    cos, sin = np.cos(poses[:, 2]).tolist(), np.sin(poses[:, 2]).tolist()
    lines = [
        f"{c!r} {-s!r} 0 {x!r} {s!r} {c!r} 0 {y!r} 0 0 1 0\n"
        for (x, y), c, s in zip(poses[:, :2].tolist(), cos, sin, strict=True)
    ]
    write_whole(path, "".join(lines))
