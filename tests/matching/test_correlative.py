"""The correlative search: branch and bound against all poses, and on known poses."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mapmend.geometry import se2
from mapmend.grid.likelihood import likelihood_field
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.correlative import MOST_POINTS, Region, _blocks, search
from tests.matching.scenes import errors, scene
from tests.reference.matching import all_scores


def disc(prior, radius_m, angle_rad, tie_weight, tie_radii=(1.0, 0.2)):
    """The region about one guess, the prior itself."""
    return Region(prior, prior[None, :2], radius_m, angle_rad, tie_weight, *tie_radii)


def plain_scores(field, points, region):
    """All scores of a region about one guess, its prior."""
    size = field.cell_size_m
    step = size / 10.0
    half = int(np.ceil(region.angle_rad / step))
    radius = max(region.radius_m / size, 1.0)
    return all_scores(
        field.levels[0],
        points[:: max(1, len(points) // MOST_POINTS)],
        {
            "centre": (region.prior[:2] - np.array(field.origin)) / size,
            "thetas": region.prior[2] + step * np.arange(-half, half + 1),
            "radius": radius,
            "tie_radius": region.tie_radius_m / size,
            "tie_turn": region.tie_radius_rad,
            "tie_weight": region.tie_weight,
            "prior_theta": region.prior[2],
            "cell_size_m": size,
        },
    )


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 5),
    st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(-0.3, 0.3)),
    st.floats(0.1, 1.2),
    st.floats(0.0, 0.12),
    st.tuples(st.sampled_from([0.0, 0.03, 0.3]), st.tuples(st.floats(0.1, 2.0), st.floats(0.02, 0.4))),
)
def test_branch_and_bound_finds_the_best_of_all_poses(seed, offset, radius_m, angle_rad, ties):
    tie_weight, tie_radii = ties
    s = scene(seed)
    field, points = likelihood_field(s.grid.tiles, 0.1), s.scan_at(s.here, 1)
    prior = se2.compose(s.here, offset)
    region = disc(prior, radius_m, angle_rad, tie_weight, tie_radii)
    scores = plain_scores(field, points, region)
    best = max(scores.values())
    found = search(field, points, region, 0.0)
    assert found is not None
    pose, score = found
    assert score == pytest.approx(best, abs=1e-12)
    # Where several poses share the best score, any of them is right.
    dx, dy = np.rint((pose[:2] - prior[:2]) / field.cell_size_m).astype(int)
    assert scores[int(dx), int(dy), float(pose[2])] == pytest.approx(best, abs=1e-12)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 5), st.floats(0.2, 1.0), st.sampled_from([-0.1, -1e-9, 1e-9, 0.1]))
def test_only_what_beats_the_score_is_found(seed, radius_m, margin):
    s = scene(seed)
    field, points = likelihood_field(s.grid.tiles, 0.1), s.scan_at(s.here, 2)
    region = disc(s.here, radius_m, 0.05, 0.03)
    best = max(plain_scores(field, points, region).values())
    found = search(field, points, region, best + margin)
    assert (found is None) == (margin > 0.0)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 5), st.tuples(st.floats(-1.4, 1.4), st.floats(-1.4, 1.4), st.floats(-0.3, 0.3)), st.integers(0, 9)
)
def test_the_true_pose_is_found_from_metres_away(seed, offset, scan_seed):
    s = scene(seed)
    prior = se2.compose(s.here, offset)
    found = search(likelihood_field(s.grid.tiles, 0.1), s.scan_at(s.here, scan_seed), disc(prior, 2.0, 0.35, 0.0), 0.3)
    assert found is not None
    away_m, turned_rad = errors(found[0], s.here)
    assert away_m < 0.12
    # Two of the search's steps of 0.01 rad, and no rounding error on top to trip over.
    assert turned_rad < 0.0201


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 5), st.tuples(st.floats(-18.0, 18.0), st.floats(-18.0, 18.0)), st.integers(0, 9))
def test_a_wide_search_by_coarse_blocks_finds_no_less_than_a_near_one(seed, offset, scan_seed):
    """From up to 25 m away, beyond what is searched by small blocks; the tie weight leaves the score to decide."""
    s = scene(seed)
    field, points = likelihood_field(s.grid.tiles, 0.1), s.scan_at(s.here, scan_seed)
    size = field.cell_size_m
    away = np.rint(np.array(offset) / size) * size
    near = search(field, points, disc(s.here, 0.5, 0.05, 0.0), 0.3)
    wide = search(field, points, disc(s.here + np.array([*away, 0.0]), 26.0, 0.05, 0.0), 0.3)
    assert near is not None
    assert wide is not None
    assert wide[1] >= near[1] - 1e-12
    assert errors(wide[0], s.here)[0] < 0.12


def test_guesses_along_a_line_reach_a_pose_that_none_of_their_discs_alone_would():
    s = scene(2)
    field, points = likelihood_field(s.grid.tiles, 0.1), s.scan_at(s.here, 3)
    prior = se2.compose(s.here, (2.5, 0.0, 0.05))
    way = np.linspace(0.0, 1.0, 60)[:, None]
    line = prior[:2] + way * (s.here[:2] - prior[:2])
    assert search(field, points, disc(prior, 0.2, 0.1, 0.0), 0.7) is None
    found = search(field, points, Region(prior, line, 0.2, 0.1, 0.0, 1.0, 0.1), 0.7)
    assert found is not None
    assert errors(found[0], s.here)[0] < 0.12


def test_ties_go_to_the_pose_nearest_the_prior():
    """Along a bare corridor all places score alike."""
    grid = SurfaceGrid(0.05)
    y = np.where(np.arange(400) < 200, 1.0, -1.0)
    points = np.column_stack((np.tile(np.linspace(-2.0, 2.0, 200), 2), y, np.zeros(400), -y, np.zeros(400)))
    for shift in np.linspace(-8.0, 8.0, 161):
        grid.insert(points, np.zeros(3), np.array([shift, 0.0, 0.0]))
    field = likelihood_field(grid.tiles, 0.1)
    for x in (-3.0, 0.0, 2.0):
        prior = np.array([x, 0.0, 0.0])
        found = search(field, points, disc(prior, 2.0, 0.05, 0.03, (2.0, 0.05)), 0.3)
        assert found is not None
        assert found[0] == pytest.approx(prior, abs=0.11)


def test_nothing_is_found_without_points_or_far_from_the_grid():
    s = scene(0)
    field = likelihood_field(s.grid.tiles, 0.1)
    region = disc(s.here, 1.0, 0.1, 0.0)
    assert search(field, np.zeros((0, 5)), region, 0.0) is None
    far = s.here + np.array([300.0, -300.0, 0.0])
    assert search(field, s.scan_at(s.here, 4), disc(far, 1.0, 0.1, 0.0), 0.0) is None
    assert search(likelihood_field(SurfaceGrid(0.05).tiles, 0.1), s.scan_at(s.here, 4), region, 0.0) is None


coordinates = st.one_of(st.floats(-60.0, 60.0), st.integers(-60, 60).map(float), st.just(7.9))


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=6),
    st.one_of(st.floats(0.0, 40.0), st.integers(0, 40).map(float)),
    st.sampled_from([1, 8, 32]),
)
@example([(7.9, 7.9)], 24.0, 8)
def test_every_offset_of_every_disc_lies_in_a_block(guesses, radius, width):
    guesses = np.array(guesses)
    blocks = _blocks(guesses, radius, width)
    assert len(np.unique(blocks, axis=0)) == len(blocks)
    assert (blocks % width == 0).all()
    known = {tuple(block) for block in blocks.tolist()}
    wanted = set()
    for guess in guesses:
        low, high = np.ceil(guess - radius).astype(int), np.floor(guess + radius).astype(int)
        cells = np.stack(np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)), axis=-1)
        cells = cells.reshape(-1, 2)
        inside = cells[((cells - guess) ** 2).sum(axis=1) <= radius**2]
        inside = np.concatenate((inside, np.rint(guess).astype(int)[None]))
        wanted |= {tuple(block) for block in (inside // width * width).tolist()}
    assert wanted <= known
    # And few beyond: only such as a disc touches between its offsets.
    for block in known - wanted:
        away = np.maximum(np.maximum(block - guesses, guesses - (np.array(block) + width - 1)), 0.0)
        assert (np.hypot(*away.T) <= max(radius, np.sqrt(0.5)) + 1e-9).any()


def test_blocks_of_many_guesses_far_apart_are_found_once():
    way = np.linspace(0.0, 900.0, 400)[:, None] * np.array([[1.0, 0.4]])
    blocks = _blocks(way, 24.0, 8)
    assert len(np.unique(blocks, axis=0)) == len(blocks)
    assert len(blocks) < 1.3 * (2 * 24 + 16) * np.hypot(900.0, 360.0) / 64
