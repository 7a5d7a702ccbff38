"""What changes in a building while a robot maps it: people who walk, and things that are moved from place to place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from mapmend.errors import MapmendError
from mapmend.geometry.se2 import Array, compose
from mapmend.scan import Scans
from mapmend.simulation._shapes import boxes
from mapmend.simulation.ray_casting import cast_rays
from mapmend.simulation.robot import SHORTEST_RANGE_M, LaserModel
from mapmend.simulation.world import World

LEG_WIDTH_M = 0.13
LEGS_APART_M = 0.25
WALKING_MPS = 1.1
ROOM_FOR_ROBOT_M = 0.45
"""The least distance of moved things from the robot's path."""


@dataclass(frozen=True)
class Dynamics:
    """How many people walk along the robot's path, and how many things are elsewhere in the drive's second half."""

    people: int = 0
    moved_objects: int = 0

    def __post_init__(self) -> None:
        if self.people < 0 or self.moved_objects < 0:
            raise MapmendError(f"people and moved objects must not be negative, got {self}")


STATIC = Dynamics()


def scan_changing_world(
    world: World, laser: LaserModel, truth: Array, stamps_s: Array, seed: int, *, dynamics: Dynamics = STATIC
) -> Scans:
    """The scans that a robot takes at poses ``truth`` (n, 3), in the world's frame, at stamps (n,).

    People walk back and forth along the world's route; each moved thing is at one place up to the middle of the stamps
    and at another from then on. The same arguments give the same bytes.
    """
    people_rng, objects_rng, noise_rng, loss_rng = (default_rng(s) for s in SeedSequence(seed).spawn(4))
    geometry = laser.geometry
    lasers, bearings = compose(truth, geometry.T_robot_laser), geometry.bearings_rad()
    ranges = np.full((len(truth), geometry.beam_count), np.inf)
    later = stamps_s >= (stamps_s[0] + stamps_s[-1]) / 2.0
    for rows in (~later, later):
        walls = np.vstack((world.walls, boxes(_placed_objects(world, dynamics.moved_objects, objects_rng))))
        ranges[rows] = cast_rays(walls, lasers[rows], bearings, geometry.max_range_m)
    walkers = [_walk(world.route, stamps_s, people_rng) for _ in range(dynamics.people)]
    for k, pose in enumerate(lasers):
        legs = _legs([walk[k] for walk in walkers], pose, geometry.max_range_m)
        if len(legs):
            ranges[k] = np.minimum(ranges[k], cast_rays(legs, pose[None], bearings, geometry.max_range_m)[0])
    readings = ranges + laser.range_noise_std_m * noise_rng.standard_normal(ranges.shape)
    readings = np.maximum(readings, SHORTEST_RANGE_M)
    readings[(readings >= geometry.max_range_m) | (loss_rng.random(ranges.shape) < laser.lost_share)] = np.inf
    offsets = np.arange(len(truth) + 1, dtype=np.int64) * geometry.beam_count
    return Scans(readings.astype(np.float32).ravel(), offsets, np.zeros(len(truth), np.int32), (geometry,))


def _placed_objects(world: World, count: int, rng: Generator) -> list[tuple[float, float, float, float]]:
    """Boxes beside the route, none on the robot's path."""
    placed: list[tuple[float, float, float, float]] = []
    way = _along(world.route, np.arange(0.0, world.route_length_m(), 0.1))
    while len(placed) < count:
        width, depth = rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.6)
        x, y = way[rng.integers(len(way))] + rng.uniform(-2.0, 2.0, 2)
        half = np.array([width, depth]) / 2.0
        gap = np.max(np.abs(way - (x, y)) - half, axis=1)
        if gap.min() >= ROOM_FOR_ROBOT_M:
            placed.append((x - half[0], y - half[1], x + half[0], y + half[1]))
    return placed


def _walk(route: Array, stamps_s: Array, rng: Generator) -> Array:
    """The position of a person at each stamp, (n, 4): x, y, and the direction of the path."""
    length = float(np.sum(np.hypot(*np.diff(route, axis=0).T)))
    begin, span = rng.uniform(0.0, length), rng.uniform(8.0, 20.0)
    phase = (rng.uniform(0.0, 2.0 * span) + WALKING_MPS * stamps_s) % (2.0 * span)
    way = (begin + np.minimum(phase, 2.0 * span - phase)) % length
    here = _along(route, way)
    ahead = _along(route, (way + 0.1) % length) - here
    sideways = np.stack((-ahead[:, 1], ahead[:, 0]), axis=1) / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    return np.hstack((here + rng.uniform(-0.5, 0.5) * sideways, sideways))


def _legs(people: list[Array], pose: Array, reach_m: float) -> Array:
    """The legs of the people within reach, except those who would be where the robot is, as segments (k, 4)."""
    half = LEG_WIDTH_M / 2.0
    legs = []
    for x, y, side_x, side_y in people:
        if ROOM_FOR_ROBOT_M < np.hypot(x - pose[0], y - pose[1]) < reach_m:
            for sign in (-0.5, 0.5):
                leg_x, leg_y = x + sign * LEGS_APART_M * side_x, y + sign * LEGS_APART_M * side_y
                legs.append((leg_x - half, leg_y - half, leg_x + half, leg_y + half))
    return boxes(legs)


def _along(route: Array, way_m: Array) -> Array:
    """Points at the given lengths along a route (k, 2): (m, 2)."""
    lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(route, axis=0).T))))
    return np.stack([np.interp(way_m, lengths, route[:, axis]) for axis in (0, 1)], axis=1)
