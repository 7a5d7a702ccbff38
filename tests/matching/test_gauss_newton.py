"""Gauss-Newton on surfaces: against derivatives of the robust cost, and on known poses."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching import _kernels
from mapmend.matching.gauss_newton import NO_PRIOR, SurfaceMatcher, prior_at, round_prior
from tests.grid.contents import Contents
from tests.matching.scenes import errors, scene
from tests.reference.matching import associations, gradient, judged, normal_matrix, robust_cost

SIZE = 0.05
scene_seeds = st.integers(0, 5)
offsets = st.tuples(st.floats(-0.12, 0.12), st.floats(-0.12, 0.12), st.floats(-0.06, 0.06))


def raw_match(grid, points, start, prior=NO_PRIOR, iterations=0):
    """What the kernel itself says: by default only the sums at ``start``."""
    settings_ = _kernels.MatchSettings(0.2, 0.1, 0.03, iterations, 1e-4, 1.0, True)
    return _kernels.match_points(grid.tiles, points, np.array(start), prior, settings_)


@settings(max_examples=12, deadline=None)
@given(scene_seeds, offsets)
def test_the_normal_matrix_is_that_of_numerical_derivatives(seed, offset):
    s = scene(seed)
    points, start = s.scan_at(s.here, 1), se2.compose(s.here, offset)
    pairs = associations(Contents(s.grid), points, start, SIZE, 0.2)
    expected = normal_matrix(pairs, points, start, 0.1)
    np.testing.assert_allclose(raw_match(s.grid, points, start).normal_matrix, expected, rtol=1e-4, atol=1e-3)


@settings(max_examples=12, deadline=None)
@given(scene_seeds, offsets)
def test_a_step_is_that_of_the_robust_costs_gradient(seed, offset):
    s = scene(seed)
    points, start = s.scan_at(s.here, 2), se2.compose(s.here, offset)
    pairs = associations(Contents(s.grid), points, start, SIZE, 0.2)
    expected = gradient(lambda p: robust_cost(pairs, points, p, 0.1), start)
    step = raw_match(s.grid, points, start, iterations=1).pose - start
    np.testing.assert_allclose(-raw_match(s.grid, points, start).normal_matrix @ step, expected, rtol=1e-3, atol=1e-3)


def posts(seed=0, count=30):
    """A grid of posts all around, none of which has a direction, and the scan (count, 5) that it was made from."""
    rng = np.random.default_rng(seed)
    bearings = np.linspace(-np.pi, np.pi, count, endpoint=False)
    ranges = rng.uniform(2.0, 6.0, count)
    points = np.column_stack(
        (ranges * np.cos(bearings), ranges * np.sin(bearings), np.zeros((count, 2)), np.ones(count))
    )
    grid = SurfaceGrid(SIZE)
    grid.insert(points, np.zeros(3), np.zeros(3))
    return grid, points


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), offsets)
def test_the_normal_matrix_and_the_step_on_posts_are_those_of_their_thin_points_alone(seed, offset):
    grid, points = posts(seed)
    points[:, 4] = np.random.default_rng(seed).uniform(size=len(points)) < 0.6
    start = np.array(offset)
    pairs = associations(Contents(grid), points, start, SIZE, 0.2)
    result = raw_match(grid, points, start)
    np.testing.assert_allclose(result.normal_matrix, normal_matrix(pairs, points, start, 0.1), rtol=1e-4, atol=1e-3)
    assert result.matched == len(associations(Contents(grid), points, start, SIZE, 0.1))  # whether thin or not
    step = raw_match(grid, points, start, iterations=1).pose - start
    expected = gradient(lambda p: robust_cost(pairs, points, p, 0.1), start)
    np.testing.assert_allclose(-result.normal_matrix @ step, expected, rtol=1e-3, atol=1e-3)


@settings(max_examples=25, deadline=None)
@given(offsets)
def test_posts_hold_in_every_direction_and_other_points_without_a_direction_in_none(offset):
    grid, points = posts()
    match = SurfaceMatcher(MatchConfig()).match(grid, points, np.array(offset))
    assert match.pose == pytest.approx(np.zeros(3), abs=2e-3)
    points[:, 4] = 0.0
    match = SurfaceMatcher(MatchConfig()).match(grid, points, np.array(offset))
    assert match.pose == pytest.approx(np.array(offset))
    assert np.all(match.normal_matrix == 0.0)


@settings(max_examples=8, deadline=None)
@given(scene_seeds, offsets)
def test_the_count_of_matched_points_is_that_of_the_definition(seed, offset):
    s = scene(seed)
    points, start = s.scan_at(s.here, 3), se2.compose(s.here, offset)
    contents = Contents(s.grid)
    result = raw_match(s.grid, points, start)
    assert result.matched == len(associations(contents, points, start, SIZE, 0.1))


@settings(max_examples=10, deadline=None)
@given(scene_seeds, offsets)
def test_a_prior_pulls_as_hard_as_its_information_says(seed, offset):
    """At the end neither the surfaces nor the prior pull harder: the gradients cancel."""
    s = scene(seed)
    points = s.scan_at(s.here, 4)
    expected_pose = se2.compose(s.here, offset)
    prior = prior_at(expected_pose, np.diag([0.002, 0.003, 0.001]) ** 2)
    result = raw_match(s.grid, points, s.here, prior, iterations=40)
    pose = result.pose
    pairs = associations(Contents(s.grid), points, pose, SIZE, 0.2)
    surfaces = gradient(lambda p: robust_cost(pairs, points, p, 0.1), pose)
    variance = max(0.03**2, result.squares / result.weights)
    difference = pose - expected_pose
    difference[2] = float(se2.wrap_angle(difference[2]))
    pull = variance * prior[:3] @ difference
    scale = np.abs(surfaces).max() + np.abs(pull).max()
    # Associations change while the pose creeps: a step back and forth of 0.1 mm on a stiff prior is what may be left.
    np.testing.assert_allclose(surfaces + pull, 0.0, atol=0.02 * scale + 2e-4 * np.abs(variance * prior[:3]).max())


@settings(max_examples=40, deadline=None)
@given(scene_seeds, offsets)
def test_a_displaced_scan_is_found_to_a_fifth_of_a_cell(seed, offset):
    s = scene(seed)
    match = SurfaceMatcher(MatchConfig()).match(s.grid, s.scan_at(s.here, 5), se2.compose(s.here, offset))
    away_m, turned_rad = errors(match.pose, s.here)
    assert away_m < SIZE / 5
    assert turned_rad < 0.002
    assert match.score > 0.9


def test_matching_is_finer_than_cells_can_be_told_apart():
    """Errors over many scans and places, against those of points on the centres of their cells, seen just as well."""
    fine, coarse = [], []
    for seed in range(6):
        s = scene(seed)
        centres = SurfaceGrid(SIZE)
        for k, pose in enumerate(s.poses):
            points = s.scan_at(pose, 100 + k)
            there = (np.floor(se2.transform_points(pose, points[:, :2]) / SIZE) + 0.5) * SIZE
            points[:, :2] = se2.transform_points(se2.inverse(pose), there)
            centres.insert(points, np.zeros(3), pose)
        matcher = SurfaceMatcher(MatchConfig())
        for k in range(6, 19):
            pose, points = s.poses[k], s.scan_at(s.poses[k], 200 + k)
            start = se2.compose(pose, (0.05, -0.05, 0.03))
            fine.append(errors(matcher.match(s.grid, points, start).pose, pose)[0])
            coarse.append(errors(matcher.match(centres, points, start).pose, pose)[0])
    assert np.mean(fine) < 0.003
    assert np.mean(fine) < 0.6 * np.mean(coarse)


@settings(max_examples=15, deadline=None)
@given(scene_seeds, offsets, st.integers(0, 3), st.tuples(st.integers(-9, 9), st.integers(-9, 9)))
def test_matching_moves_with_a_grid_that_is_turned_and_moved(seed, offset, quarters, tiles):
    s = scene(seed)
    moved_by = np.array([tiles[0] * 32 * SIZE, tiles[1] * 32 * SIZE, quarters * np.pi / 2])
    there = SurfaceGrid(SIZE)
    for k, pose in enumerate(s.poses):
        there.insert(s.scan_at(pose, 100 + k), np.zeros(3), se2.compose(moved_by, pose))
    points, start = s.scan_at(s.here, 6), se2.compose(s.here, offset)
    matcher = SurfaceMatcher(MatchConfig())
    here = matcher.match(s.grid, points, start)
    moved = matcher.match(there, points, se2.compose(moved_by, start))
    said_here, said_there = (matcher.uncertainty(grid, points, m) for grid, m in ((s.grid, here), (there, moved)))
    away_m, turned_rad = errors(moved.pose, se2.compose(moved_by, here.pose))
    assert away_m < 2e-4
    assert turned_rad < 1e-4
    # In its own frame, the covariance is the same too.
    np.testing.assert_allclose(said_there.covariance, said_here.covariance, rtol=0.1, atol=1e-7)


def test_along_a_bare_corridor_the_prior_decides_and_the_covariance_says_so():
    grid = SurfaceGrid(SIZE)
    y = np.where(np.arange(200) < 100, 1.0, -1.0)
    x = np.tile(np.linspace(-4.0, 4.0, 100), 2)
    points = np.column_stack((x, y, np.zeros(200), -y, np.zeros(200)))
    for shift in np.linspace(-3.0, 3.0, 61):
        grid.insert(points, np.zeros(3), np.array([shift, 0.0, 0.0]))
    expected = np.array([0.3, 0.0, 0.0])
    start = np.array([0.3, 0.05, 0.02])
    matcher = SurfaceMatcher(MatchConfig())
    match = matcher.match(grid, points, start, round_prior(expected, 0.5, 0.5))
    assert match.pose == pytest.approx(expected, abs=0.01)
    covariance = matcher.uncertainty(grid, points, match).covariance
    assert np.sqrt(covariance[0, 0]) > 1.0
    assert np.sqrt(covariance[1, 1]) < 0.02


def test_a_scan_outside_the_grid_stays_where_the_prior_has_it_and_scores_nothing():
    s = scene(0)
    far = s.here + np.array([500.0, 500.0, 0.0])
    match = SurfaceMatcher(MatchConfig()).match(s.grid, s.scan_at(s.here, 7), far, round_prior(far, 0.1, 0.1))
    assert match.score == 0.0
    assert match.pose == pytest.approx(far)
    assert np.all(match.normal_matrix == 0.0)


def test_a_scan_without_returns_stays_where_it_is_believed_to_be():
    s = scene(0)
    match = SurfaceMatcher(MatchConfig()).match(s.grid, np.zeros((0, 5)), s.here)
    assert match.score == 0.0
    assert match.pose == pytest.approx(s.here)
    assert SurfaceMatcher(MatchConfig()).judge(s.grid, np.zeros((0, 5)), s.here) == (0, 0, 0)


def test_the_other_side_of_a_wall_is_no_counterpart():
    grid = SurfaceGrid(SIZE)
    x = np.linspace(-2.0, 2.0, 81)
    seen = np.column_stack((x, np.full(81, 1.0), np.zeros(81), np.full(81, -1.0), np.zeros(81)))
    grid.insert(seen, np.zeros(3), np.zeros(3))
    behind = seen * (1.0, 1.0, 1.0, -1.0, 1.0)
    assert raw_match(grid, seen, (0.0, 0.05, 0.0)).matched > 70
    assert raw_match(grid, behind, (0.0, 0.05, 0.0)).matched == 0


def test_a_thin_wall_seen_from_both_sides_is_a_counterpart_for_both():
    grid = SurfaceGrid(SIZE)
    x = np.linspace(-2.0, 2.0, 81)
    seen = np.column_stack((x, np.full(81, 1.01), np.zeros(81), np.full(81, -1.0), np.zeros(81)))
    behind = seen * (1.0, 1.0, 1.0, -1.0, 1.0)
    for _ in range(3):
        grid.insert(seen, np.zeros(3), np.zeros(3))
        grid.insert(behind, np.array([0.0, 2.0, 0.0]), np.zeros(3))
    assert raw_match(grid, seen, (0.0, 0.02, 0.0)).matched > 70
    assert raw_match(grid, behind, (0.0, 0.02, 0.0)).matched > 70


@settings(max_examples=10, deadline=None)
@given(scene_seeds, st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3.1, 3.1)))
def test_judging_counts_as_the_plain_twin_does(seed, offset):
    s = scene(seed)
    points, pose = s.scan_at(s.here, 8), se2.compose(s.here, offset)
    contents = Contents(s.grid)
    tiles = {(row // 32, column // 32) for row, column in contents.cells_of_tiles.values()}
    expected = judged(contents, tiles, points, pose, (SIZE, 0.1, 0.2))
    assert SurfaceMatcher(MatchConfig()).judge(s.grid, points, pose) == expected


def test_judging_confirms_the_true_place_and_contradicts_a_wrong_one():
    s = scene(1)
    points = s.scan_at(s.here, 9)
    matcher = SurfaceMatcher(MatchConfig())
    matched, contradicted, _ = matcher.judge(s.grid, points, s.here)
    assert matched > 0.9 * len(points)
    assert contradicted < 0.05 * len(points)
    matched, contradicted, _ = matcher.judge(s.grid, points, se2.compose(s.here, (0.7, 0.7, 0.9)))
    assert contradicted > 0.3 * len(points)


@settings(max_examples=30, deadline=None)
@given(st.floats(-3.1, 3.1), st.integers(0, 1000))
def test_a_prior_says_the_same_in_map_axes_as_in_the_poses_frame(theta, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) + 3.0 * np.eye(3)
    covariance, pose = root @ root.T, np.array([1.0, 2.0, theta])
    prior = prior_at(pose, covariance)
    small = 1e-6 * rng.normal(size=3)  # a motion in the pose's own frame
    in_map = se2.compose(pose, small) - pose
    assert in_map @ prior[:3] @ in_map == pytest.approx(small @ np.linalg.solve(covariance, small), rel=1e-4)
    np.testing.assert_allclose(
        prior_at(pose, np.diag([0.04, 0.04, 0.01])), round_prior(pose, 0.2, 0.1), rtol=1e-9, atol=1e-9
    )
