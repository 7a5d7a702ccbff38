"""Logs whose odometry jumps between two scans: a reported step that no robot can do, by which all later poses shift.

The scans and their stamps stay as they are. Wheel encoders that are reset, messages that are lost and odometry that is
corrected by another source do this.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.scan import ScanLog

Float = NDArray[np.float64]

PLACES = ("any", "standing", "driving", "turning")

STANDING_M, STANDING_RAD = 0.005, 0.005
"""A robot whose step is below both stands."""

TURNING_RAD = 0.05
"""A robot whose step turns by at least so much turns."""

EDGE_SCANS = 20
"""No jump is so near to the begin or the end of a log."""


@dataclass(frozen=True)
class JumpModel:
    """``count`` jumps of ``length_m`` in a random direction with a turn of ``turn_rad`` to a random side.

    ``place`` is one of PLACES: what the robot does when the odometry jumps. Raises MapmendError for another place, and
    for a negative count or length.
    """

    count: int = 3
    length_m: float = 2.0
    turn_rad: float = 1.0
    place: str = "any"

    def __post_init__(self) -> None:
        if self.place not in PLACES:
            raise MapmendError(f"there is no place '{self.place}'; use one of {', '.join(PLACES)}")
        if self.count < 0 or not 0.0 <= self.length_m < np.inf:
            raise MapmendError(f"jumps need count >= 0 and length_m >= 0, got {self}")


def with_jumps(log: ScanLog, model: JumpModel, seed: int) -> tuple[ScanLog, tuple[int, ...]]:
    """The log with seeded jumps, and the scans that each leads to; the same arguments give the same bytes.

    Raises MapmendError where the log has not enough such places.
    """
    generator = np.random.default_rng(seed)
    steps = se2.between(log.odometry[:-1], log.odometry[1:])
    length_m, turn_rad = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    stands = (length_m < STANDING_M) & (turn_rad < STANDING_RAD)
    is_there = {"any": np.ones(len(steps), np.bool_), "standing": stands, "driving": ~stands}
    is_there["turning"] = turn_rad >= TURNING_RAD
    rows = np.flatnonzero(is_there[model.place])
    rows = rows[(rows >= EDGE_SCANS) & (rows < len(steps) - EDGE_SCANS)]
    if len(rows) < model.count:
        raise MapmendError(f"the log has {len(rows)} places '{model.place}' for {model.count} jumps; ask for fewer")
    chosen = np.sort(generator.choice(rows, model.count, replace=False))
    directions = generator.uniform(-np.pi, np.pi, model.count)
    turns = model.turn_rad * generator.choice((-1.0, 1.0), model.count)
    odometry = log.odometry.copy()
    for row, direction, turn in zip(chosen.tolist(), directions.tolist(), turns.tolist(), strict=True):
        jump = np.array((model.length_m * np.cos(direction), model.length_m * np.sin(direction), turn))
        origin = odometry[row]
        later = se2.between(origin, odometry[row + 1 :])
        odometry[row + 1 :] = se2.compose(se2.compose(origin, jump), later)
    return replace(log, odometry=odometry), tuple(int(row) + 1 for row in chosen)
