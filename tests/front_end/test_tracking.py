"""Tracking one scan: plain matching in normal cases, hypotheses where the odometry is far off."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.front_end.tracking import Tracker
from mapmend.geometry import se2
from mapmend.matching.gauss_newton import SurfaceMatcher
from tests.matching.scenes import errors, scene

CONFIG = Config()
ASTRAY = np.array([1.3, 0.3, 0.9])  # where the truth is a metre ahead


def tracker(config=CONFIG):
    return Tracker(SurfaceMatcher(config.match), config)


@pytest.mark.parametrize("seed", range(6))
def test_good_odometry_needs_no_hypotheses(seed):
    s = scene(seed)
    before, motion = s.poses[11], se2.between(s.poses[11], s.poses[12])
    tracked = tracker().track(s.grid, s.scan_at(s.here, 1), before, motion + np.array([0.01, 0.0, 0.005]))
    assert not tracked.searched
    assert errors(tracked.match.pose, s.here)[0] < 0.01


@pytest.mark.parametrize("seed", range(6))
def test_odometry_half_a_metre_and_half_a_radian_off_is_mended_by_hypotheses(seed):
    """Too far for Gauss-Newton alone."""
    s = scene(seed)
    points, before = s.scan_at(s.here, 2), se2.compose(s.here, (-1.0, 0.0, 0.0))
    alone = SurfaceMatcher(CONFIG.match).match(s.grid, points, se2.compose(before, ASTRAY))
    assert errors(alone.pose, s.here)[0] > 0.15
    tracked = tracker().track(s.grid, points, before, ASTRAY)
    assert tracked.searched
    assert errors(tracked.match.pose, s.here)[0] < 0.02


def test_a_scan_of_few_points_is_left_to_the_odometry():
    s = scene(0)
    far = s.here + np.array([0.0, 0.0, 1.0])
    tracked = tracker().track(s.grid, s.scan_at(s.here, 3)[:10], far, np.zeros(3))
    assert not tracked.searched


def test_in_a_place_never_seen_the_prediction_stays():
    s = scene(0)
    before, motion = s.here + np.array([300.0, 0.0, 0.0]), np.array([0.1, 0.0, 0.02])
    tracked = tracker().track(s.grid, s.scan_at(s.here, 4), before, motion)
    assert tracked.match.pose == pytest.approx(se2.compose(before, motion))


def test_a_poor_match_follows_odometry_that_good_matches_have_confirmed():
    """The same poor match, after scans for which the odometry was right and where it slipped."""
    s = scene(0)
    points = s.scan_at(s.here, 6)
    astray = np.concatenate((points, points[::2] * (0.55, 0.55, 1.0, 1.0, 1.0)))  # every third beam hits a passer-by
    motion = np.array([0.2, 0.0, 0.0])
    before = se2.compose(s.here, se2.inverse(motion))
    wrong = se2.compose(before, (0.0, 0.0, 0.01))
    drawn = []
    for slip_rad in (0.0, 0.05):
        follower = tracker()
        for _ in range(400):
            follower.track(s.grid, points, se2.compose(before, (0.0, 0.0, slip_rad)), motion)
        pose = follower.track(s.grid, astray, wrong, motion).match.pose
        drawn.append(abs(float(se2.between(s.here, pose)[2])) / 0.01)
    assert drawn[0] > 0.5
    assert drawn[1] < 0.5 * drawn[0]


def test_one_seed_gives_the_same_bytes():
    s, results = scene(3), []
    for _ in range(2):
        tracked = tracker(replace(CONFIG, seed=5)).track(
            s.grid, s.scan_at(s.here, 5), se2.compose(s.here, (-1.0, 0.0, 0.0)), ASTRAY
        )
        results.append(tracked.match.pose.tobytes())
    assert results[0] == results[1]
