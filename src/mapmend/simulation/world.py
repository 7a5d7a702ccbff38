"""Buildings: walls as line segments, and a route that a robot can drive without touching them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array
from mapmend.simulation._ring_floor import CABINET_DEPTH_M, RingFloor, Room, cabinets_along, furnish
from mapmend.simulation._shapes import WALL_THICKNESS_M, boxes, closed_line


@dataclass(frozen=True)
class World:
    """A building. ``walls``: shape (n, 4), segments ``x1 y1 x2 y2``, metres; ``route``: shape (k, 2), way-points.

    Raises MapmendError for other shapes, numbers that are not finite, or a route of fewer than two points.
    """

    walls: Array
    name: str
    route: Array

    def __post_init__(self) -> None:
        if self.walls.ndim != 2 or self.walls.shape[1] != 4:
            raise MapmendError(f"walls must have shape (n, 4), got {self.walls.shape}")
        if self.route.ndim != 2 or self.route.shape[1] != 2 or len(self.route) < 2:
            raise MapmendError(f"a route must have shape (k, 2) with at least two points, got {self.route.shape}")
        if not (np.all(np.isfinite(self.walls)) and np.all(np.isfinite(self.route))):
            raise MapmendError(f"walls and route of {self.name} must be finite")

    def clearance_m(self, points: ArrayLike) -> Array:
        """The distance from each of the points, shape (m, 2), to the nearest wall: shape (m,), inf without walls."""
        spots = np.asarray(points, dtype=np.float64)
        nearest = np.full(len(spots), np.inf)
        for x1, y1, x2, y2 in self.walls:
            nearest = np.minimum(nearest, _distance_to_segment(spots, np.array([x1, y1]), np.array([x2, y2])))
        return nearest

    def route_length_m(self) -> float:
        """The length of the path from point to point."""
        return float(np.sum(np.hypot(*np.diff(self.route, axis=0).T)))


def corridor_loop() -> World:
    """A ring of corridors, 18 m x 23 m outside; in the middle of each, a laser of 8 m sees only two walls.

    After the office of IGO section V-B, 17 m x 22 m and about 80 m of driving. One corner is a lobby with furniture,
    the other three have a few niches; between them the walls are bare. The route is 82 m, one round and 8 m more.
    """
    niche_m = 0.2
    outside = [(0.0, 0.0), (18.0, 0.0)]
    for y0, y1 in ((0.5, 1.3), (2.4, 3.4), (20.6, 21.5)):  # on the right wall
        outside += [(18.0, y0), (18.0 + niche_m, y0), (18.0 + niche_m, y1), (18.0, y1)]
    outside += [(18.0, 23.0)]
    for x0, x1 in ((16.6, 15.8), (14.9, 14.4), (2.0, 0.9)):  # on the upper wall
        outside += [(x0, 23.0), (x0, 23.0 + niche_m), (x1, 23.0 + niche_m), (x1, 23.0)]
    outside += [(0.0, 23.0)]
    for y0, y1 in ((20.3, 19.1), (3.9, 3.1)):  # on the left wall
        outside += [(0.0, y0), (-niche_m, y0), (-niche_m, y1), (0.0, y1)]
    inside = [(6.0, 2.0), (16.0, 2.0), (16.0, 21.0), (2.0, 21.0), (2.0, 5.0), (6.0, 5.0)]
    lobby = [
        (3.2, 2.9, 3.5, 3.2),
        (4.9, 2.9, 5.6, 4.1),
        (2.5, 4.3, 4.1, 4.9),
        (0.1, 0.1, 0.4, 0.4),
        (4.0, 0.0, 5.2, 0.3),
    ]
    walls = np.vstack((closed_line(outside), closed_line(inside), boxes(lobby)))
    route = np.array([(1.5, 1.0), (17.0, 1.0), (17.0, 22.0), (1.0, 22.0), (1.0, 1.0), (9.5, 1.0)])
    return World(walls, "corridor loop", route)


def office_floor() -> World:
    """An office floor, 30 m x 20 m: a ring of corridors with cabinets, sixteen furnished rooms, six of them visited."""
    floor = RingFloor(
        width_m=30.0,
        below_m=5.0,
        inside_m=6.0,
        above_m=5.0,
        corridor_m=2.0,
        below=_rooms((0.0, 4.5, 9.0, 15.0, 19.0, 24.5, 30.0), (1.2, 7.8, 12.0, 16.2, 23.4, 26.0), "ovsovo"),
        inside=_rooms((2.0, 8.0, 13.5, 20.0, 28.0), (6.5, 9.5, 16.0, 26.0), "OvoV"),
        above=_rooms((0.0, 5.5, 10.0, 16.5, 21.0, 25.0, 30.0), (2.5, 6.4, 14.0, 17.3, 24.0, 28.5), "svoosv"),
    )
    floor = _furnished(floor, np.random.default_rng(2009))
    return World(floor.walls(), "office floor", floor.route())


def random_building(seed: int) -> World:
    """A random ring floor: dimensions, rooms, doors, furniture, the rooms visited, and the orientation are random.

    16 m to 30 m wide and 13 m to 21 m high; half of the buildings are turned by a quarter turn, half are mirrored, so
    that the robot drives round in either direction. The same seed gives the same building.
    """
    rng = np.random.default_rng(seed)
    corridor_m, width_m = float(rng.uniform(1.8, 2.6)), float(rng.uniform(16.0, 30.0))
    below_m, inside_m, above_m = (float(x) for x in rng.uniform(3.2, 5.4, 3))
    floor = RingFloor(
        width_m=width_m,
        below_m=below_m,
        inside_m=inside_m,
        above_m=above_m,
        corridor_m=corridor_m,
        below=_random_rooms(0.0, width_m, rng),
        inside=_random_rooms(corridor_m, width_m - corridor_m, rng),
        above=_random_rooms(0.0, width_m, rng),
    )
    floor = _furnished(floor, rng)
    walls, route = floor.walls(), floor.route()
    if rng.uniform() < 0.5:  # mirrored: a route that turned left turns right
        walls, route = walls * [-1.0, 1.0, -1.0, 1.0], route * [-1.0, 1.0]
    if rng.uniform() < 0.5:  # a quarter turn
        walls, route = walls[:, [1, 0, 3, 2]] * [-1.0, 1.0, -1.0, 1.0], route[:, [1, 0]] * [-1.0, 1.0]
    return World(walls, f"random building {seed}", route)


WORLDS: dict[str, Callable[[int], World]] = {
    "corridor": lambda _seed: corridor_loop(),
    "office": lambda _seed: office_floor(),
    "random": random_building,
}
"""The buildings by name; only the random one depends on the seed."""


def world_named(name: str, seed: int = 0) -> World:
    """The building of that name; raises MapmendError for a name that is not in `WORLDS`."""
    if name not in WORLDS:
        raise MapmendError(f"there is no building {name!r}; there are {', '.join(WORLDS)}")
    return WORLDS[name](seed)


def _rooms(edges_m: tuple[float, ...], doors_m: tuple[float, ...], kinds: str) -> tuple[Room, ...]:
    """Rooms from left to right, one letter each: s(hut), o(pen) or v(isited); a capital if the door opens upwards."""
    return tuple(
        Room(x0, x1, door, kind in "oOvV", kind in "vV", kind.isupper())
        for (x0, x1), door, kind in zip(pairwise(edges_m), doors_m, kinds, strict=True)
    )


def _random_rooms(x0_m: float, x1_m: float, rng: np.random.Generator) -> tuple[Room, ...]:
    count = max(1, round((x1_m - x0_m) / float(rng.uniform(3.6, 6.0))))
    shares = rng.uniform(0.8, 1.2, count)
    edges = x0_m + (x1_m - x0_m) * np.concatenate(([0.0], np.cumsum(shares) / shares.sum()))
    rooms = []
    for left, right in pairwise(edges):
        door = float(rng.uniform(left + 0.9, right - 0.9))
        is_open, visited, opens_up = (bool(x) for x in rng.uniform(size=3) < (0.7, 0.5, 0.5))
        rooms.append(Room(float(left), float(right), door, is_open, visited, opens_up))
    return tuple(rooms)


def _furnished(floor: RingFloor, rng: np.random.Generator) -> RingFloor:
    """The floor with furniture in its rooms and cabinets along its corridors."""
    first, second, third, fourth, top = floor.levels_m()
    half = WALL_THICKNESS_M / 2.0

    def filled(rooms: tuple[Room, ...], low_m: float, high_m: float) -> tuple[Room, ...]:
        return tuple(replace(room, furniture=furnish(room, (low_m, high_m), rng)) for room in rooms)

    def cabinets(y_m: float, depth_m: float, rooms: list[Room]) -> list[tuple[float, float, float, float]]:
        ends = (floor.corridor_m, floor.width_m - floor.corridor_m)
        return cabinets_along(y_m, depth_m, ends, [room.door_x_m for room in rooms], rng)

    standing = [
        *cabinets(first + half, CABINET_DEPTH_M, list(floor.below)),
        *cabinets(second - half, -CABINET_DEPTH_M, [r for r in floor.inside if not r.opens_up]),
        *cabinets(third + half, CABINET_DEPTH_M, [r for r in floor.inside if r.opens_up]),
        *cabinets(fourth - half, -CABINET_DEPTH_M, list(floor.above)),
    ]
    return replace(
        floor,
        below=filled(floor.below, 0.0, first),
        inside=filled(floor.inside, second, third),
        above=filled(floor.above, fourth, top),
        cabinets=tuple(standing),
    )


def _distance_to_segment(points: Array, begin: Array, end: Array) -> Array:
    along = end - begin
    length_squared = max(float(along @ along), 1e-300)
    share = np.clip((points - begin) @ along / length_squared, 0.0, 1.0)
    return np.hypot(*(points - begin - share[:, None] * along).T)
