"""The log contains the true motion with the given faults and no others."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.scan import LaserGeometry
from mapmend.simulation import LaserModel, OdometryModel, SlipEvent, World, corridor_loop, random_building, simulate
from mapmend.simulation._shapes import box
from mapmend.simulation.drive import Traction, plan_drive
from mapmend.simulation.robot import HALF_CIRCLE_LASER

ONE_BEAM = LaserModel(LaserGeometry(1, 0.0, 1.0, 8.0))
"""For tests of the motion alone: quick."""

STRAIGHT = World(box((-2.0, -1.0, 22.0, 1.0)), "straight", np.array([[0.0, 0.0], [20.0, 0.0]]))


def content(simulation):
    log = simulation.log
    arrays = (log.scans.ranges_m, log.scans.offsets, log.stamps_s, log.odometry, simulation.truth, simulation.path_m)
    return b"".join(a.tobytes() for a in arrays) + repr(simulation.slips).encode()


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others():
    slippery = OdometryModel(random_slip_count=2)
    first, second, other = (simulate(random_building(5), None, slippery, seed) for seed in (1, 1, 2))
    assert content(first) == content(second)
    assert content(first) != content(other)


def test_streams_are_apart_so_that_one_fault_does_not_disturb_another():
    world = random_building(5)
    plain = simulate(world, seed=4)
    lossy = simulate(world, LaserModel(lost_share=0.2), seed=4)
    assert lossy.log.odometry.tobytes() == plain.log.odometry.tobytes()
    kept = np.isfinite(lossy.log.scans.ranges_m)
    np.testing.assert_array_equal(lossy.log.scans.ranges_m[kept], plain.log.scans.ranges_m[kept])


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.8))
def test_odometry_without_noise_is_the_truth_seen_from_the_start(seed, turn_radius_m):
    simulation = simulate(random_building(seed), ONE_BEAM, OdometryModel.exact(), seed, turn_radius_m=turn_radius_m)
    expected = se2.between(simulation.truth[0], simulation.truth)
    np.testing.assert_allclose(simulation.log.odometry[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(se2.wrap_angle(simulation.log.odometry[:, 2] - expected[:, 2]), 0.0, atol=1e-9)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000))
def test_the_robot_keeps_its_speeds(seed):
    simulation = simulate(random_building(seed), ONE_BEAM, speed_mps=0.5, turn_rate_radps=0.7, scan_interval_s=0.25)
    steps = se2.between(simulation.truth[:-1], simulation.truth[1:])
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.5 * 0.25 + 1e-9
    assert np.abs(steps[:, 2]).max() <= 0.7 * 0.25 + 1e-9
    assert np.sum(np.hypot(steps[:, 0], steps[:, 1])) == pytest.approx(simulation.path_m[-1], rel=0.01)
    np.testing.assert_allclose(np.diff(simulation.log.stamps_s), 0.25)


def test_speeds_wander_by_as_much_as_they_are_told_and_forget():
    world = World(box((-2.0, -1.0, 2002.0, 1.0)), "long", np.array([[0.0, 0.0], [2000.0, 0.0]]))
    simulation = simulate(world, ONE_BEAM, seed=3, speed_std_share=0.1)
    speeds = np.diff(simulation.path_m) / 0.2 / 0.4 - 1.0
    # 5,000 s of drive are some 800 independent speeds: their deviation is known to 3 %, its mean to 0.4 %.
    assert abs(speeds.mean()) < 0.015
    assert 0.085 < speeds.std() < 0.115
    later = np.corrcoef(speeds[:-15], speeds[15:])[0, 1]
    assert 0.25 < later < 0.5
    np.testing.assert_allclose(simulation.log.stamps_s, 0.2 * np.arange(len(simulation.log)), atol=1e-6)
    assert 1999.0 < simulation.path_m[-1] <= 2000.0


def test_the_drive_begins_and_ends_where_the_route_does():
    world = corridor_loop()
    simulation = simulate(world, seed=0)
    np.testing.assert_allclose(simulation.truth[0], [1.5, 1.0, 0.0], atol=1e-12)
    np.testing.assert_array_equal(simulation.log.odometry[0], 0.0)
    assert np.hypot(*(simulation.truth[-1, :2] - world.route[-1])) < 0.4 * 0.2
    assert 1000 <= len(simulation.log) <= 1500


def test_part_of_what_slipping_wheels_report_does_not_happen():
    slip = SlipEvent(start_m=5.0, length_m=4.0, share=0.25)
    simulation = simulate(STRAIGHT, None, OdometryModel.exact((slip,)))
    truth_m, reported_m = simulation.truth[:, 0], simulation.log.odometry[:, 0]
    before, after = truth_m <= 5.0, truth_m >= 8.0
    np.testing.assert_allclose(reported_m[before], truth_m[before], atol=1e-9)
    np.testing.assert_allclose(reported_m[after], truth_m[after] + 1.0, atol=1e-9)
    during = ~before & ~after
    np.testing.assert_allclose((reported_m[during] - 5.0) * 0.75, truth_m[during] - 5.0, atol=1e-9)
    # The wheels turn as ever: what is reported advances evenly.
    np.testing.assert_allclose(np.diff(reported_m), 0.08, atol=1e-9)


def test_wheels_that_spin_on_the_spot_and_wheels_that_skid():
    spin = simulate(STRAIGHT, None, OdometryModel.exact((SlipEvent(10.0, 2.0, 1.0),)))
    stands = np.flatnonzero(np.diff(spin.truth[:, 0]) == 0.0)
    assert len(stands) == pytest.approx(2.0 / 0.08, abs=2)
    np.testing.assert_allclose(spin.truth[stands, 0], 10.0)
    assert spin.log.odometry[-1, 0] - spin.truth[-1, 0] == pytest.approx(2.0)
    skid = simulate(STRAIGHT, None, OdometryModel.exact((SlipEvent(10.0, 2.0, -0.5),)))
    assert skid.log.odometry[-1, 0] - skid.truth[-1, 0] == pytest.approx(-1.0)


def test_slips_in_a_row_add_up():
    slips = (SlipEvent(8.0, 2.0, 0.5), SlipEvent(2.0, 3.0, 0.2), SlipEvent(9.0, 1.0, 0.3))
    simulation = simulate(STRAIGHT, None, OdometryModel.exact(slips))
    assert [slip.start_m for slip in simulation.slips] == [2.0, 8.0, 9.0]
    assert simulation.log.odometry[-1, 0] - simulation.truth[-1, 0] == pytest.approx(0.6 + 1.0 + 0.3)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(0.1, 5.0), st.floats(-1.0, 0.9)), max_size=5))
def test_ground_and_wheels_are_each_others_inverse(gaps):
    slips, at_m = [], 0.0
    for gap, length, share in gaps:
        slips.append(SlipEvent(at_m + gap, length, share))
        at_m = slips[-1].end_m
    traction, way = Traction.with_slips(slips), np.linspace(0.0, at_m + 3.0, 60)
    np.testing.assert_allclose(traction.travelled_m(traction.reported_m(way)), way, atol=1e-9)
    excess = sum(slip.share * slip.length_m for slip in slips)
    assert traction.reported_m(at_m + 3.0) == pytest.approx(at_m + 3.0 + excess)


def test_random_slips_lie_on_straight_stretches():
    for seed in range(10):
        simulation = simulate(corridor_loop(), ONE_BEAM, replace(OdometryModel.exact(), random_slip_count=5), seed)
        assert len(simulation.slips) == 5
        for slip in simulation.slips:
            inside = (simulation.path_m >= slip.start_m) & (simulation.path_m <= slip.end_m)
            assert np.ptp(simulation.truth[inside, 2]) < 1e-9
            assert 1.0 <= slip.length_m <= 3.0
            assert 0.2 <= slip.share <= 0.6


def test_the_noise_is_as_large_as_it_says():
    model = OdometryModel(0.03, 0.0, 0.02, 0.0, 0.0)
    runs = [simulate(STRAIGHT, ONE_BEAM, model, seed) for seed in range(80)]
    ends = np.array([run.log.odometry[-1] - run.truth[-1] for run in runs])
    np.testing.assert_allclose(ends.mean(axis=0), 0.0, atol=0.04)
    np.testing.assert_allclose(ends.std(axis=0)[:2], np.array([0.03, 0.02]) * np.sqrt(20.0), rtol=0.25)


def test_systematic_errors_are_systematic():
    model = replace(OdometryModel.exact(), translation_scale=1.02, rotation_scale=0.9, rotation_bias_radpm=0.001)
    simulation = simulate(corridor_loop(), None, model, turn_radius_m=0.0)
    reported = np.diff(np.unwrap(simulation.log.odometry[:, 2])).sum()
    true = np.diff(np.unwrap(simulation.truth[:, 2])).sum()
    assert reported == pytest.approx(0.9 * true + 0.001 * simulation.path_m[-1])
    straight = simulate(STRAIGHT, None, replace(OdometryModel.exact(), translation_scale=1.02))
    assert straight.log.odometry[-1, 0] == pytest.approx(1.02 * straight.truth[-1, 0])


def test_ranges_have_the_noise_the_steps_and_the_losses_that_were_asked_for():
    exact, noisy, rounded, lossy = (
        simulate(STRAIGHT, LaserModel(**faults)).log.scans.ranges_m
        for faults in (
            {"range_noise_std_m": 0.0},
            {"range_noise_std_m": 0.02},
            {"quantization_m": 0.05},
            {"lost_share": 0.1},
        )
    )
    seen = exact < 7.9
    assert np.std(noisy[seen] - exact[seen]) == pytest.approx(0.02, rel=0.02)
    steps = rounded[np.isfinite(rounded)] / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-4)
    assert np.mean(np.isinf(lossy[seen])) == pytest.approx(0.1, abs=0.005)
    assert np.all((noisy < 8.0) | np.isinf(noisy))


def test_noise_makes_no_range_negative():
    close = World(box((-0.01, -0.01, 1.01, 0.01)), "closet", np.array([[0.0, 0.0], [1.0, 0.0]]))
    ranges = simulate(close, LaserModel(range_noise_std_m=0.1)).log.scans.ranges_m
    assert ranges.min() > 0.0


def test_the_laser_is_where_it_is_mounted():
    mounted = replace(HALF_CIRCLE_LASER, T_robot_laser=(0.1, 0.2, np.pi / 2.0))
    simulation = simulate(STRAIGHT, LaserModel(mounted, range_noise_std_m=0.0), OdometryModel.exact())
    ranges = simulation.log.scans.ranges_of(0)
    # Turned to the left: beam 0 looks along the corridor, whose end is out of reach, and beam 90 at the wall.
    assert np.isinf(ranges[0])
    assert ranges[90] == pytest.approx(0.8)
    back = LaserGeometry(1, np.pi, 1.0, 8.0, (0.1, 0.2, 0.0))
    behind = simulate(STRAIGHT, LaserModel(back, range_noise_std_m=0.0)).log.scans.ranges_of(0)
    assert behind[0] == pytest.approx(2.1)


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda: simulate(STRAIGHT, scan_interval_s=0.0), "scan_interval_s"),
        (lambda: simulate(STRAIGHT, speed_mps=-1.0), "speeds must be positive"),
        (lambda: SlipEvent(0.0, 1.0, 1.1), "share <= 1"),
        (lambda: SlipEvent(0.0, -1.0, 0.5), "length_m > 0"),
        (
            lambda: simulate(STRAIGHT, None, OdometryModel(slips=(SlipEvent(1, 2, 0), SlipEvent(2, 2, 0)))),
            "begins before",
        ),
        (lambda: simulate(STRAIGHT, None, OdometryModel(slips=(SlipEvent(20, 1, 0.5),))), "after the end"),
        (lambda: simulate(STRAIGHT, None, OdometryModel(random_slip_count=50)), "do not fit"),
        (lambda: OdometryModel(forward_std_m_after_1_m=-0.1), "must not be negative"),
        (lambda: LaserModel(lost_share=1.5), "lost_share"),
        (lambda: plan_drive(np.zeros((2, 2)), 1.0, 1.0, 0.0), "coincide"),
    ],
)
def test_what_cannot_be_simulated_is_refused(call, complaint):
    with pytest.raises(MapmendError, match=complaint):
        call()


def test_a_simulation_is_quick():
    begin = time.process_time()
    simulate(corridor_loop(), seed=0)
    assert time.process_time() - begin < 1.5
