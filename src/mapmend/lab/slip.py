"""Real logs whose wheels slip on demand: the odometry reports motion that did not happen. IGO section V-A.

The scans of a recording show where the robot really was. So the scans and their stamps stay as they are, and the
odometry is changed. While a slip lasts, every step that the log reports is multiplied by ``1 / (1 - share)``: of the
``length_m`` that the wheels then report, this share did not happen. All later poses shift along, as those of wheels do.

Three kinds, as wheels slip on wax, on a sill or against a cable:

- ``along``: both wheels slip while the robot drives, mostly on straight stretches (`STRAIGHT_SHARE`).
- ``turn``: both slip while it turns; the share of the reported turn did not happen, and the translation is left alone.
- ``jump``: all of it between two scans: the robot stood, the wheels spun ``length_m``. The share is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.scan import ScanLog

Float = NDArray[np.float64]

KINDS = ("along", "turn", "jump")

STRAIGHT_SHARE = 0.8
"""This share of the slips is on straight stretches, the others are anywhere."""

STRAIGHT_RAD = 0.15
"""A stretch is straight if the robot turns less between any two scans of it."""

TURN_RAD = 0.5
"""A slip of kind ``turn`` begins where the robot turns by at least this angle over the next ``TURN_WAY_M``."""

TURN_WAY_M = 1.0
GAP_M = 2.0
"""The path between two slips, so that each is an event of its own."""

MOST_TRIES = 200


@dataclass(frozen=True)
class SlipModel:
    """``count`` slips of one ``kind``; during each the wheels report ``length_m``, of which ``share`` does not happen.

    For kind ``turn``, ``length_m`` is not used: the slip lasts for TURN_WAY_M of the robot's path. For ``jump`` the
    share is not used.
    Raises MapmendError for an unknown kind, a negative count, a length not above 0, a share outside [0, 1).
    """

    kind: str = "along"
    count: int = 12
    share: float = 0.5
    length_m: float = 2.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise MapmendError(f"there is no slip of kind '{self.kind}'; use one of {', '.join(KINDS)}")
        if not (self.count >= 0 and 0.0 < self.length_m < np.inf and 0.0 <= self.share < 1.0):
            raise MapmendError(f"slips need count >= 0, length_m > 0 and share in [0, 1), got {self}")


@dataclass(frozen=True)
class LogSlip:
    """The steps ``first`` to ``last - 1`` (step k leads from scan k to k + 1), and the motion that they report in
    excess."""

    first: int
    last: int
    phantom_m: float
    phantom_rad: float


@dataclass(frozen=True)
class SlippedLog:
    """``log``: with the changed odometry and nothing else changed; ``slips`` in the order of the log."""

    log: ScanLog
    slips: tuple[LogSlip, ...]


def slip_log(log: ScanLog, model: SlipModel, seed: int) -> SlippedLog:
    """The log with seeded slips; the same arguments give the same bytes.

    Raises MapmendError if the log is too short for that many slips.
    """
    steps = se2.between(log.odometry[:-1], log.odometry[1:])
    path_m = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
    windows = _windows(steps, path_m, model, default_rng(seed))
    spoiled = steps.copy()
    slips = []
    for first, last in windows:
        rows = slice(first, last)
        if model.kind == "jump":
            spoiled[first, 0] += model.length_m * _direction(steps, path_m, first)
        else:
            columns = slice(2, 3) if model.kind == "turn" else slice(0, 2)
            spoiled[rows, columns] /= 1.0 - model.share
        extra = spoiled[rows] - steps[rows]
        slips.append(LogSlip(first, last, float(np.hypot(extra[:, 0], extra[:, 1]).sum()), float(extra[:, 2].sum())))
    spoiled[:, 2] = se2.wrap_angle(spoiled[:, 2])
    return SlippedLog(replace(log, odometry=_chained(log.odometry[0], spoiled)), tuple(slips))


def _windows(steps: Float, path_m: Float, model: SlipModel, rng: Generator) -> list[tuple[int, int]]:
    """Where the slips are: rows of steps, from and to, in order and GAP_M apart."""
    way_m = {"along": (1.0 - model.share) * model.length_m, "turn": TURN_WAY_M, "jump": 0.0}[model.kind]
    heading = np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    found: list[tuple[int, int]] = []
    for _ in range(MOST_TRIES * model.count):
        if len(found) == model.count:
            break
        straight = rng.uniform() < STRAIGHT_SHARE
        begin_m = float(rng.uniform(0.0, path_m[-1] - way_m))
        # The last scan at that path length: if the robot stands there, the slip begins as it drives on.
        first = int(np.searchsorted(path_m, begin_m, side="right")) - 1
        last = max(int(np.searchsorted(path_m, begin_m + way_m)), first + 1)
        turned = float(np.ptp(heading[first : last + 1]))
        fits = abs(heading[last] - heading[first]) >= TURN_RAD if model.kind == "turn" else turned <= STRAIGHT_RAD
        is_apart = all(path_m[last] + GAP_M < path_m[a] or path_m[first] > path_m[b] + GAP_M for a, b in found)
        if is_apart and (fits or not (straight or model.kind == "turn")):
            found.append((first, last))
    if len(found) < model.count:
        raise MapmendError(f"{model.count} slips do not fit on {path_m[-1]:.0f} m; ask for fewer or shorter ones")
    return sorted(found)


def _direction(steps: Float, path_m: Float, first: int) -> float:
    """1 where the robot drives forwards about the step, -1 where it drives backwards."""
    about = np.abs(path_m[:-1] - path_m[first]) <= 0.5
    return 1.0 if steps[about, 0].sum() >= 0.0 else -1.0


def _chained(begin: Float, steps: Float) -> Float:
    """The poses along steps (n, 3) from ``begin`` (3,), shape (n + 1, 3)."""
    heading = begin[2] + np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    x = begin[0] + np.concatenate(([0.0], np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])))
    y = begin[1] + np.concatenate(([0.0], np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])))
    return np.column_stack((x, y, se2.wrap_angle(heading)))
