"""The odometry model: how its spread grows, and that hypotheses are drawn with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmend.config import MotionConfig
from mapmend.geometry import se2
from mapmend.scan_graph.motion import draw_hypotheses, odometry_covariance, odometry_std

CONFIG = MotionConfig()
motions = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3)).map(np.array)


@given(motions, st.floats(1.0, 5.0))
def test_a_longer_motion_is_never_more_certain(motion, factor):
    here, there = odometry_std(motion, CONFIG), odometry_std(motion * factor, CONFIG)
    assert there[0] >= here[0]
    assert there[1] >= here[1]


def test_beyond_the_floor_the_spread_is_in_proportion_to_the_motion():
    motion = np.array([1.0, 1.0, 1.0])
    np.testing.assert_allclose(odometry_std(4.0 * motion, CONFIG), 4.0 * np.array(odometry_std(motion, CONFIG)))


def test_standing_still_is_as_certain_as_the_floor():
    assert odometry_std(np.zeros(3), CONFIG) == (CONFIG.min_translation_std_m, CONFIG.min_rotation_std_rad)


@given(motions)
def test_forwards_and_backwards_left_and_right_are_alike(motion):
    assert odometry_std(motion, CONFIG) == pytest.approx(odometry_std(-motion, CONFIG))


@given(motions)
def test_the_covariance_is_that_of_the_standard_deviations(motion):
    translation, rotation = odometry_std(motion, CONFIG)
    np.testing.assert_allclose(
        odometry_covariance(motion, CONFIG), np.diag([translation, translation, rotation]) ** 2, rtol=1e-12
    )


def test_hypotheses_have_the_mean_and_the_covariance_that_they_were_drawn_with():
    predicted = np.array([3.0, -2.0, 3.0])  # some of them turn past pi
    root = np.array([[0.2, 0.0, 0.0], [0.1, 0.05, 0.0], [0.05, -0.02, 0.1]])
    covariance = root @ root.T
    drawn = draw_hypotheses(predicted, covariance, 40000, np.random.default_rng(1))
    assert drawn.shape == (40000, 3)
    assert np.all(np.abs(drawn[:, 2]) <= np.pi)
    steps = se2.between(predicted, drawn)
    np.testing.assert_allclose(steps.mean(axis=0), 0.0, atol=0.004)
    np.testing.assert_allclose(np.cov(steps.T), covariance, atol=0.03 * covariance.max())


def test_one_seed_draws_the_same_hypotheses():
    draws = [draw_hypotheses(np.zeros(3), np.eye(3), 30, np.random.default_rng(7)) for _ in range(2)]
    assert draws[0].tobytes() == draws[1].tobytes()
