"""When a scan's match is doubtful, and the search among other poses that the robot may have. IGO III-A."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.likelihood import Tiles, likelihood_field
from mapmend.matching.correlative import Region, search

Float = NDArray[np.float64]

# A score this far below the usual one is a drop; a scan's share of the usual score makes it follow some twenty scans.
DROP = 0.1
USUAL_SHARE = 0.05


class UsualScore:
    """The share of points that matched in recent scans. A match that falls below it is doubtful."""

    def __init__(self, config: MatchConfig) -> None:
        self._config = config
        self.value = 1.0

    def is_doubtful(self, score: float, points: int) -> bool:
        """Whether fewer of a scan's ``points`` match than required, and than so far: among leaves, few ever match."""
        config = self._config
        return points >= config.min_points and score < min(config.min_score, self.value - DROP)

    def learn(self, score: float) -> None:
        """Takes the score of the scan's final match into account."""
        self.value += USUAL_SHARE * (score - self.value)


@dataclass(frozen=True)
class Expected:
    """The ``pose`` (3,) that the motion model expects, and three of its standard deviations.

    ``weight``: by how much the score of a pose three standard deviations away or more must be higher.
    """

    pose: Float
    three_sigma_m: float
    three_sigma_rad: float
    weight: float

    def against(self, pose: Float) -> float:
        """The penalty of a pose, 0 to 1: its squared distance in three standard deviations, at most one.

        Beyond them the penalty does not grow, because the model does not hold: the errors of slip have a long tail.
        """
        step = se2.between(self.pose, pose)
        distance = (step[0] ** 2 + step[1] ** 2) / self.three_sigma_m**2 + (step[2] / self.three_sigma_rad) ** 2
        return min(float(distance), 1.0)

    def prefers(self, found: tuple[Float, float], first: tuple[Float, float], points: int) -> bool:
        """Whether the pose and score of ``found`` are better than those of ``first``, for a scan of ``points``.

        A share of matched beams is a binomial count: the gain must exceed its noise and the difference of the
        penalties.
        """
        noise = math.sqrt(max(first[1] * (1.0 - first[1]), 0.01) / points)
        gain = self.against(found[0])
        gain -= self.against(first[0])
        return found[1] > first[1] + noise + self.weight * gain


def find_among(tiles: Tiles, points: Float, hypotheses: Float, expected: Expected, config: MatchConfig) -> Float | None:
    """The pose (3,) of the best correlative score within reach of any of the ``hypotheses`` (n, 3), or None.

    ``points`` (n, 5) of the scan, robot frame. All headings between those of the hypotheses are searched.
    """
    centre = expected.pose
    away = np.hypot(*(hypotheses[:, :2] - centre[:2]).T)
    turn = float(np.abs(se2.wrap_angle(hypotheses[:, 2] - centre[2])).max())
    farthest = float(np.hypot(points[:, 0], points[:, 1]).max()) + float(away.max()) + config.reach_m
    field = likelihood_field(tiles, config.half_weight_m, (centre[0], centre[1]), farthest)
    region = Region(
        centre,
        hypotheses[:, :2],
        config.reach_m,
        turn,
        expected.weight,
        expected.three_sigma_m,
        expected.three_sigma_rad,
    )
    found = search(field, points, region, 0.0)
    return None if found is None else found[0]
