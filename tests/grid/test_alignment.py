"""The main direction of walls: found where there is one, and not where there is none."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.config import ScanConfig
from mapmend.errors import MapmendError
from mapmend.geometry.se2 import compose, inverse
from mapmend.grid.alignment import LEAST_SHARE, align_walls
from mapmend.scan import LaserGeometry, Scans
from mapmend.simulation import corridor_loop
from mapmend.simulation.ray_casting import cast_rays

LASER = LaserGeometry(181, -np.pi / 2.0, np.pi / 180.0, 30.0, (0.2, 0.0, 0.1))


def scans_in(walls, poses, noise_m=0.01):
    lasers = compose(poses, np.array(LASER.T_robot_laser))
    ranges = cast_rays(walls, lasers, LASER.bearings_rad(), LASER.max_range_m)
    ranges = ranges + np.random.default_rng(1).normal(0.0, noise_m, ranges.shape)
    n = len(poses)
    offsets = np.arange(n + 1, dtype=np.int64) * LASER.beam_count
    return Scans(ranges.astype(np.float32).ravel(), offsets, np.zeros(n, np.int32), (LASER,))


@pytest.fixture(scope="module")
def building():
    """A ring of corridors, whose walls run along the axes, and scans all around it."""
    world = corridor_loop()
    spots = np.linspace(0.0, len(world.route) - 1.001, 40)
    at = [np.interp(spots, np.arange(len(world.route)), axis) for axis in world.route.T]
    poses = np.column_stack((*at, np.random.default_rng(2).uniform(-np.pi, np.pi, len(spots))))
    return scans_in(world.walls, poses), poses


@settings(max_examples=25, deadline=None)
@given(turn=st.floats(-np.pi, np.pi), x=st.floats(-50.0, 50.0))
def test_walls_come_to_lie_along_the_axes_from_any_start(building, turn, x):
    scans, poses = building
    start = np.array([x, -3.0, turn])
    alignment = align_walls(scans, compose(inverse(start), poses), ScanConfig())
    assert alignment.found
    assert alignment.wall_share > 0.8
    turned = alignment.T_map_start[2]
    assert alignment.T_map_start[:2] == (0.0, 0.0)
    assert -np.pi / 4.0 <= turned <= np.pi / 4.0
    # What is left of the building's own turn is a whole number of quarters.
    quarters = (turned - turn) / (np.pi / 2.0)
    assert np.degrees(abs(quarters - round(quarters)) * np.pi / 2.0) < 0.05


def test_the_longer_walls_decide():
    """A hall with one wall askew: the three others are the main direction, 30 cm of noise-free wall or not."""
    corners = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 8.0], [0.0, 3.0]])
    walls = np.hstack((corners, np.roll(corners, -1, axis=0)))
    poses = np.column_stack((np.linspace(2.0, 10.0, 17), np.full(17, 1.5), np.linspace(-3.0, 3.0, 17)))
    alignment = align_walls(scans_in(walls, poses), poses, ScanConfig())
    assert abs(np.degrees(alignment.T_map_start[2])) < 0.2
    assert 0.4 < alignment.wall_share < 0.8


def test_a_round_hall_has_no_direction():
    around = np.linspace(0.0, 2.0 * np.pi, 121)
    ring = 6.0 * np.column_stack((np.cos(around), np.sin(around)))
    poses = np.column_stack((np.zeros((13, 2)), np.linspace(-3.0, 3.0, 13)))
    alignment = align_walls(scans_in(np.hstack((ring[:-1], ring[1:])), poses, 0.0), poses, ScanConfig())
    assert not alignment.found
    assert alignment.wall_share < LEAST_SHARE
    assert alignment.T_map_start == (0.0, 0.0, 0.0)


def test_scans_that_see_nothing_and_wrong_shapes(building):
    scans, poses = building
    blind = Scans(np.full_like(scans.ranges_m, np.inf), scans.offsets, scans.geometry_index, scans.geometries)
    assert not align_walls(blind, poses, ScanConfig()).found
    assert not align_walls(scans.select(np.zeros(0, np.int64)), np.zeros((0, 3)), ScanConfig()).found
    with pytest.raises(MapmendError, match=r"\(40, 3\)"):
        align_walls(scans, poses[:3], ScanConfig())
