"""Buildings can be driven through, have the given properties, and are the same each time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.simulation import LaserModel, OdometryModel, World, corridor_loop, office_floor, random_building, simulate
from mapmend.simulation.drive import plan_drive

ROBOT_RADIUS_M = 0.35


def assert_can_be_driven(world):
    drive = plan_drive(world.route, 0.4, 0.6, 0.4)
    poses, _, _ = drive.at(np.arange(0.0, drive.duration_s, 0.1))
    assert world.clearance_m(poses[:, :2]).min() > ROBOT_RADIUS_M


@pytest.mark.parametrize("build", [corridor_loop, office_floor])
def test_the_route_keeps_clear_of_all_walls(build):
    assert_can_be_driven(build())


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32))
def test_every_random_building_can_be_driven(seed):
    assert_can_be_driven(random_building(seed))


def test_random_buildings_differ_and_repeat():
    assert random_building(3).walls.tobytes() == random_building(3).walls.tobytes()
    assert len({random_building(seed).walls.tobytes() for seed in range(20)}) == 20


def test_sizes_are_those_of_the_papers_office():
    world = corridor_loop()
    low, high = world.walls.reshape(-1, 2).min(axis=0), world.walls.reshape(-1, 2).max(axis=0)
    np.testing.assert_allclose(high - low, [18.4, 23.2])
    assert world.route_length_m() == pytest.approx(82.0)
    np.testing.assert_allclose(office_floor().walls.reshape(-1, 2).max(axis=0), [30.0, 20.0])


def bare_stretches_m(simulation):
    """Ways on the ground, metres, without a break, during which all returns lie on two lines along the heading."""
    log, lengths, begin = simulation.log, [], None
    for k in range(len(log)):
        ranges, bearings = log.scans.ranges_of(k).astype(float), log.scans.geometry_of(k).bearings_rad()
        seen = np.isfinite(ranges)
        ahead, aside = ranges[seen] * np.cos(bearings[seen]), ranges[seen] * np.sin(bearings[seen])
        left, right = aside[aside > 0.0], aside[aside < 0.0]
        # Exact ranges are kept as float32: some 1e-6 m.
        is_bare = np.ptp(left) < 1e-5 and np.ptp(right) < 1e-5 and np.any(~seen) and ahead.max() > 7.0
        if is_bare and begin is None:
            begin = simulation.path_m[k]
        if begin is not None and (not is_bare or k == len(log) - 1):
            lengths.append(simulation.path_m[k] - begin)
            begin = None
    return lengths


def test_long_stretches_of_the_corridor_show_two_walls_and_nothing_else():
    exact = LaserModel(range_noise_std_m=0.0)
    lengths = bare_stretches_m(simulate(corridor_loop(), exact, OdometryModel.exact(), seed=0))
    # One on each side of the ring: 4.0, 10.2, 5.3 and 8.1 m; the fifth is the first again, cut short by the end.
    assert sum(length > 3.9 for length in lengths) == 4
    assert max(lengths) > 10.0
    assert sum(lengths) > 30.0


def test_the_office_has_no_such_stretch():
    exact = LaserModel(range_noise_std_m=0.0)
    lengths = bare_stretches_m(simulate(office_floor(), exact, OdometryModel.exact(), seed=0))
    assert max(lengths, default=0.0) < 2.0


def test_the_corners_of_the_corridor_do_not_look_alike():
    """Else a loop could close at the wrong one: of two scans halfway round, more than 10 % of the beams differ."""
    world = corridor_loop()
    simulation = simulate(world, LaserModel(range_noise_std_m=0.0), OdometryModel.exact(), seed=0)
    corners = world.route[1:5]
    ranges = np.stack([simulation.log.scans.ranges_of(k) for k in range(len(simulation.log))])
    near = [np.argmin(np.hypot(*(simulation.truth[:, :2] - corner).T)) for corner in corners]
    for a in range(4):
        for b in range(a):
            difference = np.abs(np.minimum(ranges[near[a]], 8.0) - np.minimum(ranges[near[b]], 8.0))
            assert np.mean(difference > 0.05) > 0.1


def test_clearance_by_hand():
    world = World(np.array([[0.0, 0.0, 2.0, 0.0]]), "one wall", np.array([[0.0, 1.0], [1.0, 1.0]]))
    spots = [[1.0, 0.5], [-3.0, 4.0], [2.5, 0.0]]
    np.testing.assert_allclose(world.clearance_m(spots), [0.5, 5.0, 0.5])


def test_a_world_without_a_route_is_refused():
    walls = np.zeros((1, 4))
    with pytest.raises(MapmendError, match="at least two points"):
        World(walls, "nowhere", np.zeros((1, 2)))
    with pytest.raises(MapmendError, match=r"shape \(n, 4\)"):
        World(np.zeros((1, 3)), "broken", np.zeros((2, 2)))
    with pytest.raises(MapmendError, match="finite"):
        World(walls * np.nan, "broken", np.zeros((2, 2)))


def test_scans_seen_from_the_truth_lie_on_the_walls():
    world = random_building(11)
    simulation = simulate(world, LaserModel(range_noise_std_m=0.0), seed=2)
    for k in range(0, len(simulation.log), 97):
        ranges, bearings = simulation.log.scans.ranges_of(k), simulation.log.scans.geometry_of(k).bearings_rad()
        seen = np.isfinite(ranges)
        ends = ranges[seen, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))[seen]
        assert world.clearance_m(se2.transform_points(simulation.truth[k], ends)).max() < 1e-5
