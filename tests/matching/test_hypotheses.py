"""What puts a scan in doubt, and when another pose is better."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.hypotheses import Expected, UsualScore, find_among
from tests.matching.scenes import Scene

EXPECTED = Expected(np.array([1.0, 2.0, 0.5]), 0.3, 0.1, 0.15)


def test_a_score_is_doubtful_below_the_least_and_below_the_usual():
    usual = UsualScore(MatchConfig())
    assert usual.is_doubtful(0.84, 180)
    assert not usual.is_doubtful(0.86, 180)
    assert not usual.is_doubtful(0.1, 5)
    for _ in range(200):
        usual.learn(0.5)  # among leaves
    assert not usual.is_doubtful(0.45, 180)
    assert usual.is_doubtful(0.35, 180)


def test_the_penalty_grows_with_the_square_up_to_three_standard_deviations():
    at = EXPECTED.pose
    assert EXPECTED.against(at) == 0.0
    assert EXPECTED.against(se2.compose(at, [0.15, 0.0, 0.0])) == pytest.approx(0.25)
    assert EXPECTED.against(se2.compose(at, [0.0, 0.0, -0.05])) == pytest.approx(0.25)
    assert EXPECTED.against(se2.compose(at, [0.0, 9.0, 0.0])) == 1.0


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(-1.0, 1.0))
def test_of_two_poses_at_most_one_is_preferred(first, second, step):
    here, there = (EXPECTED.pose, first), (se2.compose(EXPECTED.pose, [step, 0.0, 0.0]), second)
    assert not (EXPECTED.prefers(here, there, 180) and EXPECTED.prefers(there, here, 180))
    assert EXPECTED.prefers(there, here, 180) <= (second > first)


def test_the_pose_is_found_among_hypotheses_far_apart():
    scene, grid = Scene(4), SurfaceGrid(0.05)
    for k, pose in enumerate(scene.poses):
        grid.insert(scene.scan_at(pose, k), np.zeros(3), pose)
    points = scene.scan_at(scene.here, 77)
    jumped = se2.compose(scene.here, [1.5, -1.0, 0.8])
    hypotheses = np.array([jumped, se2.compose(scene.here, [0.1, 0.1, -0.05])])
    found = find_among(grid.tiles, points, hypotheses, Expected(jumped, 0.3, 0.1, 0.15), MatchConfig())
    assert found is not None
    off = se2.between(scene.here, found)
    assert np.hypot(off[0], off[1]) < 0.15
    assert abs(off[2]) < 0.03
