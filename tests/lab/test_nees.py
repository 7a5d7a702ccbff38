"""Normalized errors against sampling, and the band against what it promises."""

import numpy as np
import pytest

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.lab.nees import mean_nees_band, normalized_errors, pose_errors


def random_covariances(rng, n):
    roots = rng.normal(size=(n, 3, 3))
    return roots @ np.swapaxes(roots, 1, 2) + 0.1 * np.eye(3)


def test_against_the_formula_one_by_one():
    rng = np.random.default_rng(1)
    errors, covariances = rng.normal(size=(30, 3)), random_covariances(rng, 30)
    expected = [e @ np.linalg.inv(c) @ e for e, c in zip(errors, covariances, strict=True)]
    np.testing.assert_allclose(normalized_errors(errors, covariances), expected)


def test_right_covariances_lie_in_the_band_as_often_as_promised():
    rng = np.random.default_rng(2)
    covariances = random_covariances(rng, 4000)
    errors = (np.linalg.cholesky(covariances) @ rng.normal(size=(4000, 3, 1)))[..., 0]
    means = normalized_errors(errors, covariances).reshape(400, 10).mean(axis=1)
    low, high = mean_nees_band(10)
    share = np.mean((means > low) & (means < high))
    assert 0.92 < share < 0.98
    too_sure = normalized_errors(errors, covariances / 2.0).mean()
    assert too_sure > mean_nees_band(4000)[1]


def test_the_band_is_that_of_the_tables():
    # Chi-square with 30 degrees of freedom: 16.791 and 46.979 at 2.5 and 97.5 percent.
    assert mean_nees_band(10) == pytest.approx((1.6791, 4.6979), abs=1e-4)


def test_pose_errors_are_in_the_frame_of_the_estimate():
    rng = np.random.default_rng(3)
    estimated, small = rng.normal(size=(20, 3)), rng.normal(0.0, 0.1, (20, 3))
    np.testing.assert_allclose(pose_errors(estimated, se2.compose(estimated, small)), small, atol=1e-12)


def test_bad_input_is_refused():
    with pytest.raises(MapmendError, match="covariance 1 is not positive definite"):
        normalized_errors(np.ones((2, 3)), np.array([np.eye(3), -np.eye(3)]))
    with pytest.raises(MapmendError, match=r"errors \(n, d\)"):
        normalized_errors(np.ones((2, 3)), np.ones((2, 2, 2)))
    with pytest.raises(MapmendError, match="level"):
        mean_nees_band(10, level=1.0)
    with pytest.raises(MapmendError, match=r"shape \(n, 3\) alike"):
        pose_errors(np.ones((2, 3)), np.ones((3, 3)))
