"""The proposal's kernels: against their twins, the project's own matcher, and Gaussians that are known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.baselines import _filter_kernels
from mapmend.baselines._filter_kernels import Likelihood, ProposalSettings
from mapmend.baselines.gmapping import systematic
from mapmend.baselines.particle_maps import ParticleMaps
from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching._kernels import match_points
from mapmend.matching.gauss_newton import NO_PRIOR, SurfaceMatcher, match_settings, round_prior
from tests.baselines.maps import contents_of
from tests.matching.scenes import Scene
from tests.reference import particle_filter

SIZE_M = 0.05
MATCH = match_settings(MatchConfig(), is_roughness_used=False)
LIKELIHOOD = Likelihood(std_m=0.075, worst_m=0.2)
SETTINGS = ProposalSettings(0.3, MATCH, LIKELIHOOD)


class Mapped:
    """One particle's map of a scene, and a surface grid of the same."""

    def __init__(self, seed):
        self.scene = Scene(seed)
        self.maps, self.grid = ParticleMaps(1, SIZE_M), SurfaceGrid(SIZE_M, clearing_stride=1)
        for k, pose in enumerate(self.scene.poses[::2]):
            points = self.scene.scan_at(pose, k)
            self.maps.claim(points, np.zeros(3), pose[None])
            self.maps.insert(0, points, np.zeros(3), pose)
            self.grid.insert(points, np.zeros(3), pose)
        self.points = self.scene.scan_at(self.scene.here, 77)

    @property
    def map(self):
        return self.maps.of(0)


@pytest.fixture(scope="module")
def mapped():
    return Mapped(4)


def test_the_match_is_that_of_the_front_end(mapped):
    start = se2.compose(mapped.scene.here, [0.06, -0.05, 0.03])
    expected = SurfaceMatcher(MatchConfig()).match(mapped.grid, mapped.points, start)
    found = match_points(mapped.map, mapped.points, start, NO_PRIOR, MATCH)
    np.testing.assert_allclose(found.pose, expected.pose, atol=1e-3)
    assert found.matched / len(mapped.points) == pytest.approx(expected.score, abs=0.02)
    np.testing.assert_allclose(found.normal_matrix, expected.normal_matrix, rtol=0.05, atol=1.0)
    np.testing.assert_allclose(found.pose, mapped.scene.here, atol=0.01)


def test_the_prior_holds_where_the_map_says_nothing(mapped):
    nowhere = np.array([500.0, 500.0, 1.0])
    start = nowhere + np.array([0.1, 0.0, 0.0])
    found = match_points(mapped.map, mapped.points, start, round_prior(nowhere, 0.1, 0.1), MATCH)
    assert found.matched == 0
    np.testing.assert_allclose(found.pose, nowhere, atol=1e-6)
    assert not found.normal_matrix.any()


@settings(deadline=None)  # the first example compiles
@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-3.0, 3.0))
def test_the_likelihood_is_that_of_its_twin(x, y, turn):
    mapped = _ONE
    pose = se2.compose(mapped.scene.here, [x, y, turn])
    got = _filter_kernels.log_likelihood(mapped.map, mapped.points, pose, LIKELIHOOD)
    assert got == pytest.approx(
        particle_filter.log_likelihood(_CONTENTS, mapped.points, pose, (SIZE_M, *LIKELIHOOD)), abs=1e-4
    )


def fitted(mapped, prior, mode, information):
    return _filter_kernels.fit_proposal(mapped.map, mapped.points, prior, mode, information, LIKELIHOOD)


def test_without_a_map_the_proposal_is_the_odometry(mapped):
    prior = np.array([500.0, 500.0, 1.0, 0.2, 0.05])
    information = np.diag([1 / 0.2**2, 1 / 0.2**2, 1 / 0.05**2])
    mean, covariance, evidence = fitted(mapped, prior, prior[:3], information)
    np.testing.assert_allclose(mean, prior[:3], atol=1e-9)
    # 27 samples of a Gaussian: 7 % narrow in its variance, 4 % off in its integral along each axis.
    np.testing.assert_allclose(covariance, np.diag([0.2**2, 0.2**2, 0.05**2]), rtol=0.08, atol=1e-12)
    unseen = -0.5 * 0.5 * len(mapped.points) * (LIKELIHOOD.worst_m / LIKELIHOOD.std_m) ** 2
    integral = 1.5 * math.log(2.0 * math.pi) + 2.0 * math.log(0.2) + math.log(0.05)
    assert evidence == pytest.approx(unseen + integral, abs=0.15)


def test_observation_and_odometry_meet_where_bayes_says(mapped):
    here = mapped.scene.here
    off = here + np.array([0.02, 0.0, 0.0])
    prior = np.array([*off, 0.005, 0.002])  # as sure as the beams
    found = match_points(mapped.map, mapped.points, here, NO_PRIOR, MATCH)
    pose, observed = found.pose, found.normal_matrix / LIKELIHOOD.std_m**2
    told = np.diag([1 / 0.005**2, 1 / 0.005**2, 1 / 0.002**2])
    expected = np.linalg.solve(observed + told, observed @ pose + told @ off)
    mean, covariance, _ = fitted(mapped, prior, expected, observed + told)
    np.testing.assert_allclose((mean - expected) / np.array([0.002, 0.002, 0.001]), 0.0, atol=1.0)
    spread = np.sqrt(np.diag(covariance) * np.diag(observed + told))
    assert ((spread > 0.6) & (spread < 3.0)).all()


def test_better_poses_weigh_more(mapped):
    """A particle whose map fits the scan where the odometry expects it weighs more than one a hand's width off."""
    here = mapped.scene.here
    particles = particles_at(here, se2.compose(here, [0.5, 0.5, 0.0]))
    priors = np.column_stack((particles.poses, np.full(2, 0.05), np.full(2, 0.02)))
    shared = mapped.maps.shared._replace(tables=np.repeat(mapped.maps.shared.tables, 2, axis=0))
    _filter_kernels.propose(shared, 0, mapped.points, particles, priors, SETTINGS, np.zeros((2, 3)))
    assert particles.log_weights[0] > particles.log_weights[1] + 10.0
    np.testing.assert_allclose(particles.poses[0], here, atol=0.01)


def test_an_unmatched_scan_leaves_the_odometry_to_draw(mapped):
    nowhere = np.array([500.0, 500.0, 1.0])
    particles = particles_at(nowhere)
    prior = np.array([[*nowhere, 0.3, 0.1]])
    normals = np.array([[1.0, -1.0, 2.0]])
    _filter_kernels.propose(mapped.maps.shared, 0, mapped.points, particles, prior, SETTINGS, normals)
    np.testing.assert_allclose(particles.poses[0], nowhere + np.array([0.3, -0.3, 0.2]))
    np.testing.assert_allclose(particles.covariances[0], np.diag([0.09, 0.09, 0.01]))


def particles_at(*poses):
    """Particles to be proposed from these poses."""
    n = len(poses)
    return _filter_kernels.Particles(np.array(poses), np.zeros(n), np.zeros((n, 3, 3)), np.zeros(n))


@settings(deadline=None)  # the first example compiles
@given(st.lists(st.floats(1e-6, 1.0), min_size=1, max_size=40), st.floats(0.0, 0.999))
def test_resampling_draws_each_as_often_as_it_weighs(weights, shift):
    weights = np.array(weights) / np.sum(weights)
    drawn = systematic(weights, shift)
    expected = weights * len(weights)
    counts = np.bincount(drawn, minlength=len(weights))
    assert (counts >= np.floor(expected - 1e-6)).all()
    assert (counts <= np.ceil(expected + 1e-6)).all()
    assert (np.diff(drawn) >= 0).all()
    assert np.count_nonzero(drawn != particle_filter.systematic(weights.tolist(), shift)) <= 1  # rounding at an end


_ONE = Mapped(6)
_CONTENTS = contents_of(_ONE.maps, 0)
