"""Relations between the poses at two times: the ground truth of Kuemmerle et al. (Autonomous Robots, 2009)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapmend.io._decimals import Float
from mapmend.io.columns import read_columns
from mapmend.io.files import read_bytes

_FIELDS = ("t1", "t2", "x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class Relations:
    """n relations: ``relative_poses[k]``, shape (n, 3), is the pose at ``t2_s[k]`` relative to that at ``t1_s[k]``."""

    t1_s: Float
    t2_s: Float
    relative_poses: Float

    def __len__(self) -> int:
        return len(self.t1_s)


def read_relations(path: str | Path) -> Relations:
    """Read a file of lines ``t1 t2 x y z roll pitch yaw``; raises InputError that names file and line."""
    return parse_relations(read_bytes(path), path)


def parse_relations(data: bytes, path: str | Path) -> Relations:
    """The same for bytes already read; ``path`` is for messages."""
    values, _ = read_columns(data, _FIELDS, path)
    return Relations(values[:, 0].copy(), values[:, 1].copy(), np.ascontiguousarray(values[:, [2, 3, 7]]))
