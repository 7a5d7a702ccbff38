"""Correlative scan matching: the best-scoring pose of a region, for doubtful matches (IGO's [17]: Olson 2009)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.grid.likelihood import LikelihoodField
from mapmend.matching import _kernels

Float = NDArray[np.float64]

# Blocks of offsets are as wide as the cells of this level; in wide regions, of the coarsest.
NEAR_LEVEL = 3
WIDE_CELLS = 200
MOST_POINTS = 120
CELL_DIAGONAL = math.sqrt(2.0)
# The step of the angle is for points up to this range; the refinement aligns the points beyond it.
ANGLE_RANGE_M = 10.0


@dataclass(frozen=True)
class Region:
    """Where to look: discs of ``radius_m`` about ``guesses`` (n, 2), angles within ``angle_rad`` of the prior's.

    Scores within ``tie_weight`` of each other are ties, which the pose nearest to ``prior`` (3,) wins: the penalty
    grows with the squared distance from the prior, up to ``tie_radius_m`` and ``tie_radius_rad``.
    """

    prior: Float
    guesses: Float
    radius_m: float
    angle_rad: float
    tie_weight: float
    tie_radius_m: float
    tie_radius_rad: float


def search(field: LikelihoodField, points: Float, region: Region, score_to_beat: float) -> tuple[Float, float] | None:
    """The best pose (3,) and its score, or None where none beats ``score_to_beat``; ``points`` (n, 5), robot frame.

    Offsets are whole cells, and a step of the angle moves a point ten metres away by one cell: the caller refines the
    result below the cell size.
    """
    size = field.cell_size_m
    points = points[:: max(1, len(points) // MOST_POINTS)]
    if len(points) == 0:
        return None
    prior = region.prior
    centre = (prior[:2] - np.array(field.origin)) / size
    step = size / ANGLE_RANGE_M
    half = math.ceil(region.angle_rad / step)
    thetas = prior[2] + step * np.arange(-half, half + 1)
    guesses = (region.guesses - prior[:2]) / size
    reach = float(np.hypot(guesses[:, 0], guesses[:, 1]).max()) + region.radius_m / size
    level = NEAR_LEVEL if reach < WIDE_CELLS else len(field.levels) - 1
    offsets = _blocks(guesses, region.radius_m / size, 1 << level)
    settings = _kernels.SearchSettings(
        cell_size_m=size,
        score_to_beat=score_to_beat,
        tie_weight=region.tie_weight,
        prior_theta=float(prior[2]),
        tie_radius_cells=region.tie_radius_m / size,
        tie_radius_rad=region.tie_radius_rad,
        reach_cells=max(reach, 1.0),
        top=level,
    )
    best = _kernels.search_poses(field.levels, points, centre, thetas, offsets, settings)
    if not best.score > score_to_beat:
        return None
    return np.array([prior[0] + best.columns * size, prior[1] + best.rows * size, best.theta]), best.score


def _blocks(guesses: Float, radius: float, width: int) -> NDArray[np.int64]:
    """The blocks that hold every whole-cell offset in any disc: their lowest offsets, shape (m, 2), in cells.

    A disc is all offsets at most ``radius`` cells from a guess, one of ``guesses`` (n, 2), and the nearest one in any
    case. A block is ``width`` x ``width`` offsets. It is taken if the rectangle around its offsets is as near to a
    guess as that.
    """
    radius = max(radius, CELL_DIAGONAL / 2.0)
    low = np.floor((guesses.min(axis=0) - radius) / width).astype(np.int64)
    high = np.floor((guesses.max(axis=0) + radius) / width).astype(np.int64)
    covered = np.zeros(tuple(high - low + 1), dtype=np.bool_)
    # The blocks about each guess, (n, k) in x and in y: their numbers, and how far the guess is outside of them.
    around = np.arange(math.ceil(2.0 * radius / width) + 2)
    numbers = np.floor((guesses - radius) / width).astype(np.int64)[:, :, None] + around
    numbers = np.minimum(numbers, high[:, None])
    first = numbers * width
    away = np.maximum(np.maximum(first - guesses[:, :, None], guesses[:, :, None] - (first + width - 1)), 0.0)
    is_near = away[:, 0, :, None] ** 2 + away[:, 1, None, :] ** 2 <= radius**2
    guess, x, y = np.nonzero(is_near)
    covered[numbers[guess, 0, x] - low[0], numbers[guess, 1, y] - low[1]] = True
    return np.ascontiguousarray((np.argwhere(covered) + low) * width, dtype=np.int64)
