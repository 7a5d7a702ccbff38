"""SE(2) by its axioms, and covariance propagation against sampling."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mapmend.geometry import se2

coordinate = st.floats(-1e3, 1e3, allow_nan=False)
angle = st.floats(-20.0, 20.0, allow_nan=False)
pose = st.tuples(coordinate, coordinate, angle).map(np.array)


def same(a, b, tolerance=1e-8):
    return np.allclose(a[..., :2], b[..., :2], atol=tolerance) and np.allclose(
        se2.wrap_angle(a[..., 2] - b[..., 2]), 0.0, atol=tolerance
    )


@given(pose, pose, pose)
def test_composition_is_associative(a, b, c):
    assert same(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))


@given(pose)
def test_inverse_undoes_from_both_sides(a):
    identity = np.zeros(3)
    assert same(se2.compose(a, se2.inverse(a)), identity)
    assert same(se2.compose(se2.inverse(a), a), identity)


@given(pose, pose)
def test_between_leads_from_one_pose_to_the_other(a, b):
    assert same(se2.compose(a, se2.between(a, b)), b)


@given(angle)
def test_wrapped_angle_is_the_same_direction_in_one_turn(a):
    wrapped = se2.wrap_angle(a)
    assert -np.pi <= wrapped < np.pi
    assert np.isclose(np.cos(wrapped), np.cos(a))
    assert np.isclose(np.sin(wrapped), np.sin(a))


@given(pose, st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).map(np.array))
def test_adjoint_moves_a_small_step_to_the_other_side(a, direction):
    step = 1e-6 * direction
    right = se2.compose(a, step)
    left = se2.compose(se2.adjoint(a) @ step, a)
    assert same(right, left, 1e-8)


@given(pose, st.floats(0, 1))
def test_interpolation_meets_both_ends(a, share):
    b = se2.compose(a, np.array([1.0, 2.0, 0.5]))
    assert same(se2.interpolate(a, b, 0.0), a)
    assert same(se2.interpolate(a, b, 1.0), b)
    middle = se2.interpolate(a, b, share)
    assert np.isclose(np.hypot(*(middle - a)[:2]), share * np.hypot(*(b - a)[:2]), atol=1e-9)


def test_points_follow_the_pose():
    points = np.array([[1.0, 0.0], [0.0, 2.0]])
    moved = se2.transform_points(np.array([1.0, 1.0, np.pi / 2]), points)
    assert np.allclose(moved, [[1.0, 2.0], [-1.0, 1.0]])


def test_composed_covariance_agrees_with_samples():
    random = np.random.default_rng(3)
    T_a_b, T_b_c = np.array([1.0, -2.0, 0.7]), np.array([5.0, 3.0, -1.1])
    first = np.diag([0.02, 0.01, 0.01]) ** 2
    second = np.diag([0.01, 0.03, 0.005]) ** 2
    d1 = random.multivariate_normal(np.zeros(3), first, 200_000)
    d2 = random.multivariate_normal(np.zeros(3), second, 200_000)
    samples = se2.compose(se2.compose(T_a_b, d1), se2.compose(T_b_c, d2))
    errors = se2.between(se2.compose(T_a_b, T_b_c), samples)
    expected = se2.compose_covariance(first, T_b_c, second)
    assert np.allclose(np.cov(errors.T), expected, rtol=0.03, atol=2e-6)


def test_inverse_covariance_agrees_with_samples():
    random = np.random.default_rng(4)
    T_a_b = np.array([4.0, -2.0, 0.7])
    covariance = np.diag([0.02, 0.01, 0.01]) ** 2
    samples = se2.inverse(se2.compose(T_a_b, random.multivariate_normal(np.zeros(3), covariance, 200_000)))
    errors = se2.between(se2.inverse(T_a_b), samples)
    assert np.allclose(np.cov(errors.T), se2.inverse_covariance(T_a_b, covariance), rtol=0.03, atol=2e-6)


@given(st.lists(st.floats(-2, 2), min_size=9, max_size=9))
def test_symmetric_inverse_undoes_the_matrix(numbers):
    half = np.array(numbers).reshape(3, 3)
    matrix = half @ half.T + 0.1 * np.eye(3)
    assert np.allclose(se2.invert_symmetric(matrix) @ matrix, np.eye(3), atol=1e-8)


@given(pose, pose, pose)
def test_one_pose_and_many_come_out_the_same(a, b, c):
    many = np.stack((b, c))
    assert same(se2.compose(a, b), se2.compose(a[None], many)[0], 1e-9)
    assert same(se2.inverse(b), se2.inverse(many)[0], 1e-9)
    assert np.allclose(se2.adjoint(c), se2.adjoint(many)[1])
