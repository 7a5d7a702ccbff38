"""The parts of buildings: lines, boxes and walls with doors, each an array of segments (n, 4) in metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapmend.geometry.se2 import Array

Interval = tuple[float, float]
Rectangle = tuple[float, float, float, float]

WALL_THICKNESS_M = 0.12
DOOR_LEAF_M = 0.04


def closed_line(points: Sequence[tuple[float, float]]) -> Array:
    """The sides of a polygon, shape (points, 4)."""
    corners = np.array(points, dtype=np.float64)
    return np.hstack((corners, np.roll(corners, -1, axis=0)))


def box(rectangle: Rectangle) -> Array:
    """The four sides of the rectangle ``(x0, y0, x1, y1)``."""
    x0, y0, x1, y1 = rectangle
    return closed_line([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def boxes(rectangles: Sequence[Rectangle]) -> Array:
    """The sides of all the rectangles, shape (4 * rectangles, 4)."""
    return np.vstack([box(r) for r in rectangles]) if rectangles else np.zeros((0, 4))


def wall_along_x(y_m: float, ends: Interval, open_doors: Sequence[Interval], shut_doors: Sequence[Interval]) -> Array:
    """A thick wall at ``y_m`` between two x, with gaps for open doors and niches for closed ones."""
    half, leaf = WALL_THICKNESS_M / 2.0, DOOR_LEAF_M / 2.0
    parts: list[Rectangle] = [(x0, y_m - leaf, x1, y_m + leaf) for x0, x1 in shut_doors]
    begin = ends[0]
    for x0, x1 in sorted([*open_doors, *shut_doors]):
        parts.append((begin, y_m - half, x0, y_m + half))
        begin = x1
    parts.append((begin, y_m - half, ends[1], y_m + half))
    return boxes(parts)


def wall_along_y(x_m: float, ends: Interval) -> Array:
    """A thick wall without doors at ``x_m`` between two y."""
    half = WALL_THICKNESS_M / 2.0
    return box((x_m - half, ends[0], x_m + half, ends[1]))
