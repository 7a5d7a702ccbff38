"""The relation metric by hand, against its definition, and on the recordings that its numbers are published for."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.evaluation.relations import relation_errors
from mapmend.geometry import se2
from mapmend.io.carmen import read_carmen

coordinate = st.floats(-50.0, 50.0)
pose = st.tuples(coordinate, coordinate, st.floats(-7.0, 7.0)).map(np.array)


def drive(seed, n=40):
    """A wandering trajectory, its stamps, and n - 5 true relations over five steps each."""
    rng = np.random.default_rng(seed)
    steps = np.column_stack((rng.uniform(0.0, 0.5, n), rng.normal(0.0, 0.05, n), rng.normal(0.0, 0.4, n)))
    poses = [np.zeros(3)]
    for step in steps[1:]:
        poses.append(se2.compose(poses[-1], step))
    stamps, poses = np.arange(n) * 0.5, np.array(poses)
    return stamps, poses, stamps[:-5], stamps[5:], se2.between(poses[:-5], poses[5:])


def test_a_case_worked_out_by_hand():
    stamps = [0.0, 2.0, 4.0]
    poses = [[0.0, 0.0, 0.0], [2.0, 0.0, np.pi / 2], [2.0, 2.0, np.pi / 2]]
    # Truth of the first: one metre ahead, a quarter turn. The estimate is two metres ahead: 1 m off, no angle off.
    # Truth of the second: at rest. The estimate goes from (1, 0, 45 deg) to (2, 1, 90 deg): sqrt(2) m and 45 deg off.
    errors = relation_errors(
        stamps, poses, [0.0, 1.0, 10.0], [2.0, 3.0, 11.0], [[1.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0], [9.0, 9.0, 9.0]]
    )
    np.testing.assert_allclose(errors.translation_m, [1.0, np.sqrt(2.0)], atol=1e-12)
    np.testing.assert_allclose(errors.rotation_deg, [0.0, 45.0], atol=1e-12)
    assert errors.translation_mean_m == pytest.approx((1.0 + np.sqrt(2.0)) / 2.0)
    assert errors.translation_std_m == pytest.approx((np.sqrt(2.0) - 1.0) / 2.0)
    assert (errors.rotation_mean_deg, errors.rotation_std_deg) == pytest.approx((22.5, 22.5))
    assert errors.translation_max_m == pytest.approx(np.sqrt(2.0))
    assert errors.rotation_median_deg == pytest.approx(22.5)
    assert (errors.used, errors.total) == (2, 3)
    assert errors.is_used.tolist() == [True, True, False]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), pose)
def test_the_frame_of_the_trajectory_does_not_matter(seed, moved_by):
    stamps, poses, t1, t2, true = drive(seed)
    noisy = poses + np.random.default_rng(seed + 1).normal(0.0, 0.1, poses.shape)
    here = relation_errors(stamps, noisy, t1, t2, true)
    there = relation_errors(stamps, se2.compose(moved_by, noisy), t1, t2, true)
    np.testing.assert_allclose(here.translation_m, there.translation_m, atol=1e-9)
    np.testing.assert_allclose(here.rotation_deg, there.rotation_deg, atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_true_trajectory_has_no_error(seed):
    stamps, poses, t1, t2, true = drive(seed)
    errors = relation_errors(stamps, poses, t1, t2, true)
    assert errors.translation_max_m < 1e-12
    assert errors.rotation_max_deg < 1e-9


def test_relations_of_the_laser_need_its_mounting():
    stamps, poses, t1, t2, _ = drive(3)
    mounting = np.array([0.3, -0.1, 0.2])
    laser = se2.compose(poses, mounting)
    true = se2.between(laser[:-5], laser[5:])
    assert relation_errors(stamps, poses, t1, t2, true, T_robot_laser=mounting).translation_max_m < 1e-12
    assert relation_errors(stamps, poses, t1, t2, true).translation_max_m > 0.01


def test_rows_out_of_order_are_sorted_and_the_first_of_a_repeated_stamp_counts():
    stamps = np.array([2.0, 0.0, 1.0, 1.0])
    poses = np.array([[4.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [99.0, 0.0, 0.0]])
    errors = relation_errors(stamps, poses, [0.0, 1.0], [1.0, 2.0], [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    assert errors.translation_max_m == 0.0


def test_angles_are_interpolated_along_the_shorter_turn():
    poses = [[0.0, 0.0, np.pi - 0.1], [0.0, 0.0, -np.pi + 0.1]]
    errors = relation_errors([0.0, 1.0], poses, [0.0], [0.5], [[0.0, 0.0, 0.1]])
    assert errors.rotation_max_deg < 1e-9


@pytest.mark.parametrize(("outside_s", "used"), [(0.999, 1), (1.0, 1), (1.001, 0)])
def test_a_stamp_one_second_outside_still_counts(outside_s, used):
    relations = ([0.0, 0.0], [4.0, 4.0 + outside_s], [[1.0, 0.0, 0.0]] * 2)
    errors = relation_errors([0.0, 4.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], *relations)
    assert errors.used == 1 + used
    assert errors.translation_max_m == 0.0


def test_a_gap_within_the_trajectory_is_not_bridged():
    with pytest.raises(MapmendError, match="none of the 1 relations"):
        relation_errors([0.0, 10.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [0.0], [5.0], [[0.5, 0.0, 0.0]])


def test_one_pose_is_a_trajectory_too():
    errors = relation_errors([5.0], [[1.0, 2.0, 3.0]], [4.5], [5.5], [[0.0, 0.0, 0.0]])
    assert errors.translation_max_m < 1e-12


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (([0.0], [[0.0, 0.0]], [0.0], [0.0], [[0.0, 0.0, 0.0]]), r"poses \(n, 3\)"),
        (([], np.zeros((0, 3)), [0.0], [0.0], [[0.0, 0.0, 0.0]]), "has no poses"),
        (([0.0], [[0.0, 0.0, np.nan]], [0.0], [0.0], [[0.0, 0.0, 0.0]]), "not finite"),
        (([0.0], [[0.0, 0.0, 0.0]], [0.0], [0.0, 1.0], [[0.0, 0.0, 0.0]]), r"relative poses \(m, 3\)"),
        (([0.0], [[0.0, 0.0, 0.0]], [], [], np.zeros((0, 3))), "no relations"),
        (([0.0], [[0.0, 0.0, 0.0]], [0.0], [np.inf], [[0.0, 0.0, 0.0]]), "not finite"),
    ],
)
def test_input_that_cannot_be_compared_is_refused(arguments, complaint):
    with pytest.raises(MapmendError, match=complaint):
        relation_errors(*arguments)


@pytest.mark.parametrize(
    ("name", "frame", "translation_m", "rotation_deg", "total"),
    # intel's laser counts as the robot's centre. fr079's sits at x = -0.04 m: in the laser's frame the odometry scores
    # the 6.51 m that are known of it; in the robot's, 3 mm less.
    [
        ("intel", "robot", 7.3702, 39.166, 2984),
        ("fr079", "laser", 6.5072, 30.292, 1685),
        ("fr079", "robot", 6.5042, 30.292, 1685),
    ],
)
def test_raw_odometry_scores_what_is_known_of_it(name, frame, translation_m, rotation_deg, total):
    folder = os.environ.get("MAPMEND_DATA")
    if not folder:
        pytest.skip("MAPMEND_DATA is not set: the recordings are not at hand")
    table = np.loadtxt(Path(folder) / "relations" / f"{name}.relations")
    log = read_carmen(Path(folder) / "logs" / f"{name}.clf.bz2")
    mounting = log.scans.geometries[0].T_robot_laser if frame == "laser" else None
    errors = relation_errors(
        log.stamps_s, log.odometry, table[:, 0], table[:, 1], table[:, [2, 3, 7]], T_robot_laser=mounting
    )
    assert (errors.used, errors.total) == (total, total)
    assert errors.translation_mean_m == pytest.approx(translation_m, abs=1e-4)
    assert errors.rotation_mean_deg == pytest.approx(rotation_deg, abs=1e-3)
