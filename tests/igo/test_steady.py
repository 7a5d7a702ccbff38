"""A steady speed where matches observe nothing, a change of speed where they observe one."""

import numpy as np

from mapmend.igo.steady import steady_motion, usual_change

SECONDS = np.full(60, 0.6)
KNOWN = np.diag([1.0, 1.0, 1.0]) / 0.003**2


def told(speeds, open_rows, seed=0):
    """Motions with noise and their information; along x nothing is known in ``open_rows``, where motions are wrong."""
    rng = np.random.default_rng(seed)
    motions = np.zeros((60, 3))
    motions[:, 0] = speeds * SECONDS
    motions += 0.003 * rng.standard_normal((60, 3))
    information = np.broadcast_to(KNOWN, (60, 3, 3)).copy()
    motions[open_rows, 0] = 0.1
    information[open_rows, 0, 0] = 0.0
    return motions, information


def test_an_open_stretch_is_crossed_at_the_speed_of_its_ends():
    motions, information = told(np.full(60, 0.4), slice(20, 45))
    change = usual_change(motions, information, SECONDS)
    steady = steady_motion(motions, information, SECONDS, change)
    assert abs(steady.motions[20:45, 0].sum() - 25 * 0.24) < 0.03
    assert np.abs(steady.motions[:20, 0] - 0.24).max() < 0.01


def test_a_change_of_speed_stays_where_it_was_seen():
    speeds = np.where(np.arange(60) < 17, 0.2, 0.4)  # three edges of the new speed, then nothing to see
    motions, information = told(speeds, slice(20, 45))
    steady = steady_motion(motions, information, SECONDS, usual_change(motions, information, SECONDS))
    assert abs(steady.motions[20:45, 0].sum() - 25 * 0.24) < 0.1
    assert abs(steady.motions[:17, 0].sum() - 17 * 0.12) < 0.03


def test_the_covariance_of_a_stretch_is_that_of_samples_and_its_error():
    ends = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        speeds = 0.4 + 0.02 * np.cumsum(np.sqrt(0.6) * rng.standard_normal(60))
        motions, information = told(speeds, slice(20, 45), seed)
        steady = steady_motion(motions, information, SECONDS, np.full(3, 0.02))
        off = steady.motions[20:45, 0].sum() - (speeds[20:45] * SECONDS[20:45]).sum()
        ends.append(off / np.sqrt(steady.covariance_of_sum(20, 45)[0, 0]))
    assert 0.8 < np.std(ends) < 1.2


def test_the_usual_change_is_that_of_the_log():
    rng = np.random.default_rng(3)
    speeds = 0.4 + 0.02 * np.cumsum(np.sqrt(0.6) * rng.standard_normal(60))
    motions, information = told(speeds, slice(0, 0))
    assert 0.012 < usual_change(motions, information, SECONDS)[0] < 0.03
