"""A floor of rooms along a ring of corridors: rooms below it, rooms above it, and a block of rooms in its middle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from mapmend.geometry.se2 import Array
from mapmend.simulation._shapes import WALL_THICKNESS_M, Rectangle, box, boxes, wall_along_x, wall_along_y

DOOR_WIDTH_M = 1.1
DOOR_STRIP_M = 0.75
"""Half the width of the strip behind a door that is free of furniture, so that a robot gets in and out."""

CABINET_DEPTH_M = 0.25


@dataclass(frozen=True)
class Room:
    """A room between two x with one door; if the door is open and the room ``visited``, the robot drives in and out."""

    x0_m: float
    x1_m: float
    door_x_m: float
    is_open: bool = True
    visited: bool = False
    opens_up: bool = False
    furniture: tuple[Rectangle, ...] = ()


@dataclass(frozen=True)
class RingFloor:
    """The floor's dimensions from bottom to top; its lower left corner is (0, 0).

    ``below``, ``inside`` and ``above``: rooms from left to right. Rooms below open upwards, rooms above downwards, and
    those inside in either direction. ``cabinets`` are along the corridors' walls.
    """

    width_m: float
    below_m: float
    inside_m: float
    above_m: float
    corridor_m: float
    below: tuple[Room, ...]
    inside: tuple[Room, ...]
    above: tuple[Room, ...]
    cabinets: tuple[Rectangle, ...] = field(default=())

    def levels_m(self) -> tuple[float, float, float, float, float]:
        """The heights of the ring's four long walls, and of the floor's upper edge."""
        first = self.below_m
        second = first + self.corridor_m
        third = second + self.inside_m
        fourth = third + self.corridor_m
        return first, second, third, fourth, fourth + self.above_m

    def walls(self) -> Array:
        """All walls and furniture, shape (n, 4)."""
        first, second, third, fourth, top = self.levels_m()
        left, right = self.corridor_m, self.width_m - self.corridor_m
        down = [room for room in self.inside if not room.opens_up]
        up = [room for room in self.inside if room.opens_up]
        parts = [
            box((0.0, 0.0, self.width_m, top)),
            _wall_of(first, (0.0, self.width_m), self.below),
            _wall_of(second, (left, right), down),
            _wall_of(third, (left, right), up),
            _wall_of(fourth, (0.0, self.width_m), self.above),
            *(wall_along_y(room.x1_m, (0.0, first)) for room in self.below[:-1]),
            *(wall_along_y(x, (second, third)) for x in (left, *(room.x1_m for room in self.inside))),
            *(wall_along_y(room.x1_m, (fourth, top)) for room in self.above[:-1]),
            *(boxes(room.furniture) for room in (*self.below, *self.inside, *self.above)),
            boxes(self.cabinets),
        ]
        return np.vstack(parts)

    def route(self, overlap_m: float = 6.0) -> Array:
        """Once around the ring, counter-clockwise, into the rooms to visit, and on past the start: shape (k, 2)."""
        first, second, third, fourth, top = self.levels_m()
        half = self.corridor_m / 2.0
        low, high, left, right = first + half, third + half, half, self.width_m - half
        depth = self.inside_m / 2.0
        on_the_way_out = [(room.door_x_m, first / 2.0) for room in self.below if _is_visited(room)]
        on_the_way_out += [(r.door_x_m, second + depth) for r in self.inside if _is_visited(r) and not r.opens_up]
        on_the_way_back = [(r.door_x_m, (fourth + top) / 2.0) for r in self.above if _is_visited(r)]
        on_the_way_back += [(r.door_x_m, third - depth) for r in self.inside if _is_visited(r) and r.opens_up]
        points = [(left, low)]
        for x, y in sorted(on_the_way_out):
            points += [(x, low), (x, y), (x, low)]
        points += [(right, low), (right, high)]
        for x, y in sorted(on_the_way_back, reverse=True):
            points += [(x, high), (x, y), (x, high)]
        points += [(left, high), (left, low), (left + overlap_m, low)]
        # Doors that face each other would give the same point twice.
        return np.array([points[0], *(b for a, b in pairwise(points) if a != b)], dtype=np.float64)


def furnish(room: Room, floor_y: tuple[float, float], rng: np.random.Generator) -> tuple[Rectangle, ...]:
    """Up to four pieces of furniture in the room between two y, none in the strip behind its door."""
    margin = WALL_THICKNESS_M
    sides = (
        (room.x0_m + margin, room.door_x_m - DOOR_STRIP_M),
        (room.door_x_m + DOOR_STRIP_M, room.x1_m - margin),
    )
    pieces: list[Rectangle] = []
    for x0, x1 in sides:
        for _ in range(2):
            width, depth = rng.uniform(0.3, 1.4), rng.uniform(0.3, 0.9)
            x, y = rng.uniform(size=2)
            if x1 - x0 > width:
                left = x0 + x * (x1 - x0 - width)
                low = floor_y[0] + margin + y * (floor_y[1] - floor_y[0] - 2.0 * margin - depth)
                pieces.append((left, low, left + width, low + depth))
    return tuple(pieces)


def cabinets_along(
    y_m: float, depth_m: float, ends: tuple[float, float], doors_x_m: Sequence[float], rng: np.random.Generator
) -> list[Rectangle]:
    """Cabinets every few metres along a corridor's wall; ``depth_m`` is negative for cabinets below ``y_m``."""
    found: list[Rectangle] = []
    x = ends[0] + rng.uniform(0.5, 4.0)
    while x < ends[1] - 1.5:
        width = rng.uniform(0.4, 1.0)
        if all(abs(x + width / 2.0 - door) > (width + DOOR_WIDTH_M) / 2.0 + 0.1 for door in doors_x_m):
            found.append((x, min(y_m, y_m + depth_m), x + width, max(y_m, y_m + depth_m)))
        x += width + rng.uniform(1.5, 5.0)
    return found


def _is_visited(room: Room) -> bool:
    return room.is_open and room.visited


def _wall_of(y_m: float, ends: tuple[float, float], rooms: Sequence[Room]) -> Array:
    half = DOOR_WIDTH_M / 2.0
    open_doors = [(room.door_x_m - half, room.door_x_m + half) for room in rooms if room.is_open]
    shut_doors = [(room.door_x_m - half, room.door_x_m + half) for room in rooms if not room.is_open]
    return wall_along_x(y_m, ends, open_doors, shut_doors)
