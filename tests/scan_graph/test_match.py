"""One scan on a grid of others: back to where it was, as certain as the errors are, and clear about what is wrong."""

import numpy as np
import pytest

import mapmend
from mapmend.geometry import se2

SCANS, MATCHED = 60, 61


@pytest.fixture(scope="module")
def drive():
    return mapmend.simulate(mapmend.random_building(1), seed=3)


@pytest.fixture(scope="module")
def ranges(drive):
    return drive.log.scans.ranges_m.reshape(len(drive.log), -1)


@pytest.fixture(scope="module")
def geometry(drive):
    return drive.log.scans.geometries[0]


@pytest.fixture(scope="module")
def grid(drive, ranges, geometry):
    """Of every second scan."""
    return mapmend.grid_of(ranges[: 2 * SCANS : 2], geometry, drive.truth[: 2 * SCANS : 2])


def test_matches_end_where_the_robot_was_and_know_how_exactly(drive, ranges, geometry, grid):
    """From 1 dm and 0.05 rad off. NEES is 3 on average for right covariances; the grid is as noisy as the scan."""
    random = np.random.default_rng(0)
    nees = []
    for k in range(1, 2 * SCANS, 10):
        truth = drive.truth[k]
        start = truth + random.uniform((-0.1, -0.1, -0.05), (0.1, 0.1, 0.05))
        found = mapmend.match(grid, ranges[k], geometry, start)
        error = se2.between(found.pose, truth)
        assert np.hypot(error[0], error[1]) < 0.02
        assert abs(error[2]) < 0.005
        assert found.converged
        assert found.score > mapmend.Config().match.min_score
        nees.append(float(error @ np.linalg.solve(found.covariance, error)))
    assert 0.3 < np.mean(nees) < 9.0


def test_a_start_that_is_a_measurement_counts(drive, ranges, geometry, grid):
    """With a start that is known to a tenth of a millimetre, the match stays there."""
    start = drive.truth[MATCHED] + (0.05, 0.0, 0.0)
    free = mapmend.match(grid, ranges[MATCHED], geometry, start)
    held = mapmend.match(grid, ranges[MATCHED], geometry, start, start_covariance=np.diag([1e-8, 1e-8, 1e-8]))
    assert np.hypot(*(free.pose - start)[:2]) > 0.03
    assert np.hypot(*(held.pose - start)[:2]) < 0.005


def test_where_the_grid_knows_nothing_the_match_says_so(drive, ranges, geometry, grid):
    found = mapmend.match(grid, ranges[MATCHED], geometry, drive.truth[MATCHED] + (500.0, 0.0, 0.0))
    assert (found.score, found.converged) == (0.0, False)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), 10.0)


def test_one_step_does_not_converge(drive, ranges, geometry, grid):
    config = mapmend.Config().with_settings({"match.iterations": 1})
    start = drive.truth[MATCHED] + (0.1, 0.1, 0.05)
    assert not mapmend.match(grid, ranges[MATCHED], geometry, start, config=config).converged


def test_what_is_wrong_is_said(ranges, geometry, grid):
    scan, start = ranges[MATCHED], (0.0, 0.0, 0.0)
    for call, complaint in (
        (lambda: mapmend.match(grid, scan[:-1], geometry, start), r"ranges_m must have shape \(n, 180\)"),
        (lambda: mapmend.match(grid, scan, geometry, (0.0, 0.0)), r"start must have shape \(3,\), got \(2,\)"),
        (lambda: mapmend.match(grid, scan, geometry, (0.0, 0.0, np.nan)), "start must be finite"),
        (lambda: mapmend.match(grid, np.full(180, np.inf), geometry, start), "no return between 0.05 m and 30 m"),
        (lambda: mapmend.match(grid, scan, geometry, start, start_covariance=-np.eye(3)), "positive definite"),
        (lambda: mapmend.match(grid, scan, geometry, start, start_covariance=np.eye(2)), r"have shape \(3, 3\)"),
        (lambda: mapmend.match(grid, scan, geometry, start, config=mapmend.Config().match), "must be a Config"),
        (lambda: mapmend.grid_of(ranges[:3], geometry, np.zeros((2, 3))), r"poses must have shape \(3, 3\)"),
    ):
        with pytest.raises(mapmend.MapmendError, match=complaint):
            call()
    fine = mapmend.grid_of(
        ranges[:3],
        geometry,
        np.zeros((3, 3)),
        mapmend.Config().with_settings({"grid.cell_size_m": 0.025, "match.reach_m": 0.1}),
    )
    with pytest.raises(mapmend.MapmendError, match=r"match.reach_m is 0.2; this grid's cells allow 0.1 at most"):
        mapmend.match(fine, scan, geometry, start)
