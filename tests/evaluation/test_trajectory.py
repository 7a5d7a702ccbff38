"""Absolute and relative trajectory errors: invariances and known values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.evaluation.trajectory import align, relative_errors, trajectory_errors
from mapmend.geometry import se2

coordinate = st.floats(-50.0, 50.0)
pose = st.tuples(coordinate, coordinate, st.floats(-7.0, 7.0)).map(np.array)


def wander(seed, n=60):
    rng = np.random.default_rng(seed)
    steps = np.column_stack((rng.uniform(0.1, 0.5, n), np.zeros(n), rng.normal(0.0, 0.3, n)))
    poses = [np.zeros(3)]
    for step in steps[1:]:
        poses.append(se2.compose(poses[-1], step))
    return np.arange(n) * 0.2, np.array(poses)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), pose)
def test_alignment_recovers_a_known_motion(seed, motion):
    points = wander(seed)[1][:, :2]
    found = align(points, se2.transform_points(motion, points))
    np.testing.assert_allclose(found[:2], motion[:2], atol=1e-8)
    assert abs(se2.wrap_angle(found[2] - motion[2])) < 1e-9


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_no_other_motion_aligns_better(seed):
    rng = np.random.default_rng(seed)
    points, reference = rng.normal(size=(20, 2)), rng.normal(size=(20, 2))

    def cost(motion):
        return np.sum((se2.transform_points(motion, points) - reference) ** 2)

    best = align(points, reference)
    assert all(cost(best) <= cost(best + change) + 1e-12 for change in rng.normal(0.0, 0.05, (50, 3)))


def test_alignment_without_an_angle_is_a_shift():
    np.testing.assert_allclose(align([[1.0, 2.0]] * 3, [[4.0, 6.0]] * 3), [3.0, 4.0, 0.0])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), pose)
def test_a_trajectory_has_no_error_against_itself_wherever_it_lies(seed, motion):
    stamps, poses = wander(seed)
    errors = trajectory_errors(stamps, se2.compose(motion, poses), stamps, poses)
    assert errors.translation_max_m < 1e-8
    assert errors.rotation_mean_deg < 1e-6
    assert errors.used == errors.total == len(stamps)
    np.testing.assert_allclose(se2.compose(errors.T_reference_estimate, se2.compose(motion, poses)), poses, atol=1e-7)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), pose)
def test_a_rigid_motion_of_the_whole_changes_no_error(seed, motion):
    stamps, truth = wander(seed)
    estimate = truth + np.random.default_rng(seed + 1).normal(0.0, 0.1, truth.shape)
    here, there = (trajectory_errors(stamps, e, stamps, truth) for e in (estimate, se2.compose(motion, estimate)))
    np.testing.assert_allclose(here.translation_m, there.translation_m, atol=1e-8)
    np.testing.assert_allclose(here.rotation_deg, there.rotation_deg, atol=1e-6)
    here, there = (relative_errors(stamps, e, stamps, truth) for e in (estimate, se2.compose(motion, estimate)))
    np.testing.assert_allclose(here.translation_m, there.translation_m, atol=1e-8)


def test_summary_of_errors_worked_out_by_hand():
    stamps = np.arange(4.0)
    reference = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    estimate = reference + np.array([[0, 0.3, 0], [0, -0.1, 0], [0, -0.5, 0], [0, 0.3, 0.1]])
    # The four offsets sum to zero and have a lever of -0.5: the alignment turns by some 0.1 rad.
    errors = trajectory_errors(stamps, estimate, stamps, reference)
    by_hand = se2.transform_points(errors.T_reference_estimate, estimate[:, :2]) - reference[:, :2]
    np.testing.assert_allclose(errors.translation_m, np.hypot(*by_hand.T))
    assert errors.translation_rmse_m == pytest.approx(np.sqrt(np.mean(errors.translation_m**2)))
    assert errors.translation_median_m == pytest.approx(np.median(errors.translation_m))


def test_the_reference_is_interpolated_and_far_stamps_are_left_out():
    reference = np.array([[0.0, 0.0, 3.1], [1.0, 0.0, -3.1], [11.0, 0.0, 0.0]])
    angle = 3.1 + (np.pi - 3.1)
    estimate = np.array([[0.0, 0.0, 3.1], [0.5, 0.0, angle], [5.0, 3.0, 0.0], [1.0, 0.0, -3.1], [7.0, 7.0, 0.0]])
    errors = trajectory_errors(
        [0.0, 0.05, 1.0, 0.1, -0.05], estimate, [0.0, 0.1, 5.0], reference, max_difference_s=0.06
    )
    assert errors.is_used.tolist() == [True, True, False, True, False]
    assert errors.translation_max_m < 1e-12
    assert errors.rotation_mean_deg < 1e-9


def test_relative_errors_of_an_odometry_that_is_two_percent_long():
    stamps = np.arange(101) * 0.1
    truth = np.column_stack((np.arange(101) * 0.1, np.zeros(101), np.zeros(101)))
    errors = relative_errors(stamps, truth * [1.02, 1.0, 1.0], stamps, truth, distance_m=2.0)
    np.testing.assert_allclose(errors.translation_m, 0.04, atol=1e-9)
    assert (errors.used, errors.rotation_mean_deg) == (81, 0.0)


def test_what_cannot_be_compared_is_refused():
    stamps, poses = wander(1)
    with pytest.raises(MapmendError, match="has a reference pose within"):
        trajectory_errors(stamps + 1e6, poses, stamps, poses)
    with pytest.raises(MapmendError, match="less than the"):
        relative_errors(stamps, poses, stamps, poses, distance_m=1e4)
    with pytest.raises(MapmendError, match="must be positive"):
        relative_errors(stamps, poses, stamps, poses, distance_m=0.0)
    with pytest.raises(MapmendError, match="the reference has no poses"):
        trajectory_errors(stamps, poses, [], np.zeros((0, 3)))
    with pytest.raises(MapmendError, match="at least one pair"):
        align(np.zeros((0, 2)), np.zeros((0, 2)))
    with pytest.raises(MapmendError, match=r"two arrays \(n, 2\)"):
        align(np.zeros((3, 2)), np.zeros((2, 2)))
