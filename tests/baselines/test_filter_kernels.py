"""The proposal's kernels: against their twins, the project's own matcher, and Gaussians that are known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.baselines import _filter_kernels
from mapmend.baselines.gmapping import systematic
from mapmend.baselines.particle_maps import ParticleMaps
from mapmend.config import MatchConfig
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.matching.gauss_newton import SurfaceMatcher
from tests.baselines.maps import contents_of
from tests.matching.scenes import Scene
from tests.reference import particle_filter

SIZE_M = 0.05
MATCH = np.array([SIZE_M, 0.2, 0.1, 0.03, 12, 1e-4, 2.0])
LIKELIHOOD = np.array([SIZE_M, 0.075, 0.2])


class Mapped:
    """One particle's map of a scene, and a surface grid of the same."""

    def __init__(self, seed):
        self.scene = Scene(seed)
        self.maps, self.grid = ParticleMaps(1, SIZE_M), SurfaceGrid(SIZE_M, clearing_stride=1)
        for k, pose in enumerate(self.scene.poses[::2]):
            points = self.scene.scan_at(pose, k)
            settings = self.maps.claim(points, np.zeros(3), pose[None])
            self.maps.insert(0, points, pose, settings)
            self.grid.insert(points, np.zeros(3), pose)
        self.points = self.scene.scan_at(self.scene.here, 77)

    @property
    def map(self):
        return self.maps.tables[0], self.maps.frame, self.maps.cells


@pytest.fixture(scope="module")
def mapped():
    return Mapped(4)


def test_the_match_is_that_of_the_front_end(mapped):
    start = se2.compose(mapped.scene.here, [0.06, -0.05, 0.03])
    expected = SurfaceMatcher(MatchConfig()).match(mapped.grid, mapped.points, start)
    pose, normal = start.copy(), np.empty(6)
    open_prior = np.array([*start, 1e3, 1e3])
    score = _filter_kernels.match_scan(*mapped.map, mapped.points, pose, open_prior, MATCH, normal)
    np.testing.assert_allclose(pose, expected.pose, atol=1e-3)
    assert score == pytest.approx(expected.score, abs=0.02)
    np.testing.assert_allclose(normal, expected.normal_matrix[np.triu_indices(3)], rtol=0.05, atol=1.0)
    np.testing.assert_allclose(pose, mapped.scene.here, atol=0.01)


def test_the_prior_holds_where_the_map_says_nothing(mapped):
    nowhere = np.array([500.0, 500.0, 1.0])
    pose, normal = nowhere + np.array([0.1, 0.0, 0.0]), np.empty(6)
    prior = np.array([*nowhere, 0.1, 0.1])
    assert _filter_kernels.match_scan(*mapped.map, mapped.points, pose, prior, MATCH, normal) == 0.0
    np.testing.assert_allclose(pose, nowhere, atol=1e-6)
    assert not normal.any()


@settings(deadline=None)  # the first example compiles
@given(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(-3.0, 3.0))
def test_the_likelihood_is_that_of_its_twin(x, y, turn):
    mapped = _ONE
    pose = se2.compose(mapped.scene.here, [x, y, turn])
    got = _filter_kernels.log_likelihood(*mapped.map, mapped.points, pose, LIKELIHOOD)
    assert got == pytest.approx(particle_filter.log_likelihood(_CONTENTS, mapped.points, pose, LIKELIHOOD), abs=1e-4)


def fitted(mapped, prior, mode, information):
    result = np.empty(13)
    settings = np.concatenate((prior, LIKELIHOOD))
    _filter_kernels.fit_proposal(*mapped.map, mapped.points, settings, mode, information, result)
    return result[:3], result[3:12].reshape(3, 3), result[12]


def test_without_a_map_the_proposal_is_the_odometry(mapped):
    prior = np.array([500.0, 500.0, 1.0, 0.2, 0.05])
    information = np.diag([1 / 0.2**2, 1 / 0.2**2, 1 / 0.05**2])
    mean, covariance, evidence = fitted(mapped, prior, prior[:3], information)
    np.testing.assert_allclose(mean, prior[:3], atol=1e-9)
    # 27 samples of a Gaussian: 7 % narrow in its variance, 4 % off in its integral along each axis.
    np.testing.assert_allclose(covariance, np.diag([0.2**2, 0.2**2, 0.05**2]), rtol=0.08, atol=1e-12)
    unseen = -0.5 * 0.5 * len(mapped.points) * (LIKELIHOOD[2] / LIKELIHOOD[1]) ** 2
    integral = 1.5 * math.log(2.0 * math.pi) + 2.0 * math.log(0.2) + math.log(0.05)
    assert evidence == pytest.approx(unseen + integral, abs=0.15)


def test_observation_and_odometry_meet_where_bayes_says(mapped):
    here = mapped.scene.here
    off = here + np.array([0.02, 0.0, 0.0])
    pose, normal = here.copy(), np.empty(6)
    prior = np.array([*off, 0.005, 0.002])  # as sure as the beams
    _filter_kernels.match_scan(*mapped.map, mapped.points, pose, np.array([*here, 1e3, 1e3]), MATCH, normal)
    observed = np.zeros((3, 3))
    observed[np.triu_indices(3)] = normal / LIKELIHOOD[1] ** 2
    observed = observed + np.triu(observed, 1).T
    told = np.diag([1 / 0.005**2, 1 / 0.005**2, 1 / 0.002**2])
    expected = np.linalg.solve(observed + told, observed @ pose + told @ off)
    mean, covariance, _ = fitted(mapped, prior, expected, observed + told)
    np.testing.assert_allclose((mean - expected) / np.array([0.002, 0.002, 0.001]), 0.0, atol=1.0)
    spread = np.sqrt(np.diag(covariance) * np.diag(observed + told))
    assert ((spread > 0.6) & (spread < 3.0)).all()


def test_better_poses_weigh_more(mapped):
    """A particle whose map fits the scan where the odometry expects it weighs more than one a hand's width off."""
    here = mapped.scene.here
    particles = np.zeros((2, 14))
    particles[:, :3] = here, se2.compose(here, [0.5, 0.5, 0.0])
    priors = np.column_stack((particles[:, :3], np.full(2, 0.05), np.full(2, 0.02)))
    settings = np.array([0.0, 0.3, *MATCH, *LIKELIHOOD[1:]])
    tables = np.repeat(mapped.maps.tables, 2, axis=0)
    normals = np.zeros((2, 3))
    _filter_kernels.propose(
        tables, mapped.maps.frame, mapped.maps.cells, mapped.points, particles, priors, settings, normals
    )
    assert particles[0, 3] > particles[1, 3] + 10.0
    np.testing.assert_allclose(particles[0, :3], here, atol=0.01)


def test_an_unmatched_scan_leaves_the_odometry_to_draw(mapped):
    nowhere = np.array([500.0, 500.0, 1.0])
    particles = np.zeros((1, 14))
    particles[0, :3] = nowhere
    prior = np.array([[*nowhere, 0.3, 0.1]])
    settings = np.array([0.0, 0.3, *MATCH, *LIKELIHOOD[1:]])
    _filter_kernels.propose(*mapped_arguments(mapped), particles, prior, settings, np.array([[1.0, -1.0, 2.0]]))
    np.testing.assert_allclose(particles[0, :3], nowhere + np.array([0.3, -0.3, 0.2]))
    np.testing.assert_allclose(particles[0, 4:13].reshape(3, 3), np.diag([0.09, 0.09, 0.01]))


def mapped_arguments(mapped):
    return mapped.maps.tables, mapped.maps.frame, mapped.maps.cells, mapped.points


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
