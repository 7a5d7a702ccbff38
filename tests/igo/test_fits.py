"""Fits of scans: against the plain twin, and finer than scores."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmend.config import Config
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.igo.fits import TIE, Fits
from mapmend.matching.gauss_newton import SurfaceMatcher
from mapmend.scan import LaserGeometry, Scans
from mapmend.scan_graph.points import ScanPoints
from mapmend.simulation.ray_casting import cast_rays
from tests.grid.contents import Contents
from tests.matching.scenes import scene
from tests.reference import igo as reference

STEPS = st.tuples(*(st.floats(-0.3, 0.3) for _ in range(3))).map(np.array)


@pytest.mark.parametrize("seed", range(3))
def test_fits_are_those_of_the_plain_twin(seed):
    s, fits = scene(seed), Fits(Config())
    points, other = s.scan_at(s.here, 7), s.here + np.array([0.07, -0.05, 0.02])
    new, old = (reference.fits(Contents(s.grid), points, pose, 0.05, 0.2) for pose in (s.here, other))
    assert fits.fit(s.grid, points, s.here) == pytest.approx(new.mean(), abs=1e-7)  # normals are float32
    gain = new - old
    expected = (gain.mean(), gain.std() / np.sqrt(len(points)))
    assert fits.gain(s.grid, points, s.here, other) == pytest.approx(expected, abs=1e-7)


def test_no_points_fit_nowhere_and_gain_nothing():
    s, fits = scene(0), Fits(Config())
    assert fits.fit(s.grid, np.zeros((0, 5)), s.here) == 0.0
    assert fits.gain(s.grid, np.zeros((0, 5)), s.here, s.here) == (0.0, 0.0)


@given(STEPS, STEPS)
def test_what_one_pose_gains_another_loses(first, second):
    s, fits = scene(1), Fits(Config())
    points = s.scan_at(s.here, 7)
    a, b = (se2.compose(s.here, step) for step in (first, second))
    gain, noise = fits.gain(s.grid, points, a, b)
    back, same_noise = fits.gain(s.grid, points, b, a)
    assert gain == pytest.approx(-back, abs=1e-12)
    assert noise == pytest.approx(same_noise, abs=1e-12)
    difference = fits.fit(s.grid, points, a) - fits.fit(s.grid, points, b)
    assert gain == pytest.approx(difference, abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_a_pose_off_by_less_than_scores_can_tell_fits_worse_by_far(seed):
    s, config = scene(seed), Config()
    points, off = s.scan_at(s.here, 7), s.here + np.array([0.04, 0.03, 0.0])
    matcher, fits = SurfaceMatcher(config.match), Fits(config)
    right, wrong = (matcher.judge(s.grid, points, pose)[0] / len(points) for pose in (s.here, off))
    gain, noise = fits.gain(s.grid, points, s.here, off)
    assert right - wrong < 0.05
    assert gain > 0.05
    assert gain > TIE * noise


def test_along_a_bare_corridor_no_pose_is_clearly_better():
    """Neither because points fall on the same points again, nor because they stay in the area that was seen."""
    walls = np.array([[-50.0, -1.0, 50.0, -1.0], [-50.0, 1.0, 50.0, 1.0]])
    laser = LaserGeometry(180, -np.pi / 2, np.pi / 180.0, 8.0)
    poses = np.column_stack((0.3 * np.arange(20), np.zeros(20), np.zeros(20)))
    ranges = cast_rays(walls, poses, laser.bearings_rad(), laser.max_range_m).astype(np.float32)
    scans = Scans(ranges.ravel(), np.arange(21) * 180, np.zeros(20, np.int32), (laser,))
    points, grid, fits = ScanPoints(scans, Config().scan), SurfaceGrid(0.05), Fits(Config())
    for k in range(19):
        grid.insert(points.of(k), np.zeros(3), poses[k])
    gain, noise = fits.gain(grid, points.of(19), poses[18], poses[19])
    assert abs(gain) < max(TIE * noise, Config().igo.clear_gain)
