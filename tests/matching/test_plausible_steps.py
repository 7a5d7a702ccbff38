"""Which steps of the odometry are plausible: usual ones, odd ones, and jumps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmend.matching.plausible_steps import FEWEST_STEPS, MOST_OVER_FAST, plausible_steps


def drive(step_m=0.1, turn_rad=0.05, n=200):
    """Steps of a robot that drives, stands for a while, and turns."""
    steps = np.zeros((n, 3))
    steps[: n // 2, 0] = step_m
    steps[3 * n // 4 :, 2] = turn_rad
    return steps, np.arange(n + 1) * 0.2


def test_usual_steps_are_plausible_and_jumps_are_not():
    steps, stamps = drive()
    steps[20, 1] = 2.0  # to the side, while driving
    steps[120, 0] = -0.5  # while standing
    steps[170, 2] = -1.0  # while turning
    found = plausible_steps(steps, stamps)
    np.testing.assert_allclose(found.fast, (0.1, 0.05))
    expected = np.ones(len(steps))
    expected[[20, 120, 170]] = 0.0
    np.testing.assert_array_equal(found.plausibility, expected)


def test_a_step_between_a_fast_one_and_a_jump_is_odd():
    steps, stamps = drive()
    steps[20, 0] = 0.3
    assert plausible_steps(steps, stamps).plausibility[20] == pytest.approx(0.5)


def test_a_long_pause_makes_a_long_step_plausible_and_a_short_one_forbids_none():
    steps, stamps = drive()
    steps[20, 0] = 1.0
    pause = stamps.copy()
    pause[21:] += 2.0
    assert plausible_steps(steps, pause).plausibility[20] == 1.0
    steps, _ = drive()
    for broken in (np.zeros(len(stamps)), stamps[::-1].copy(), np.round(stamps)):
        assert plausible_steps(steps, broken).plausibility.min() == 1.0


def test_a_robot_that_hardly_moves_does_not_say_how_fast_it_is():
    steps, stamps = np.zeros((50, 3)), np.arange(51.0)
    assert plausible_steps(steps, stamps).plausibility.min() == 1.0
    steps[: FEWEST_STEPS - 2, 0] = 0.1  # and the jump
    steps[30, 0] = 3.0
    found = plausible_steps(steps, stamps)
    assert found.plausibility.min() == 1.0
    assert np.isfinite(found.fast).all()
    assert plausible_steps(np.zeros((0, 3)), np.zeros(1)).plausibility.shape == (0,)


@given(st.integers(0, 199), st.floats(-np.pi, np.pi), st.floats(1.01, 50.0))
def test_a_jump_in_any_direction_at_any_place(row, direction, over):
    steps, stamps = drive()
    length = MOST_OVER_FAST * 0.1 * over
    steps[row, :2] += length * np.cos(direction), length * np.sin(direction)
    found = plausible_steps(steps, stamps).plausibility
    assert np.delete(found, row).min() == 1.0
    assert found[row] <= (0.0 if over > 1.25 else 0.5)
