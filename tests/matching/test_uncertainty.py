"""How certain a match is: sums against a plain twin, variances against sampling, covariances against true errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.config import Config, MatchConfig, ScanConfig
from mapmend.front_end.builder import FrontEnd
from mapmend.geometry import se2
from mapmend.grid.surface import SurfaceGrid
from mapmend.lab.nees import normalized_errors, pose_errors
from mapmend.matching import _uncertainty_kernels as kernels
from mapmend.matching.gauss_newton import SurfaceMatcher
from mapmend.matching.uncertainty import LEAST_NOISE_M, LEAST_SURFACE_M, PointErrors, match_uncertainty
from mapmend.scan import LaserGeometry, Scans
from mapmend.scan_graph.points import ScanPoints
from mapmend.simulation import LaserModel, random_building, simulate
from mapmend.simulation.drive import plan_drive
from mapmend.simulation.ray_casting import cast_rays
from tests.grid.contents import Contents
from tests.matching.scenes import scene
from tests.reference.matching import deviations, surface_sums, surfaces

SIZE = 0.05


@settings(max_examples=12, deadline=None)
@given(
    st.integers(0, 5), st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.03, 0.03)), st.booleans()
)
def test_sums_over_surfaces_are_those_of_the_plain_twin(seed, offset, with_posts):
    s = scene(seed)
    points, pose = s.scan_at(s.here, 1), se2.compose(s.here, offset)
    if with_posts:
        points = points.copy()
        points[::7, 4] = 1.0
    found = surfaces(Contents(s.grid), points, pose, (SIZE, 0.2, 0.1))
    off, sums = np.zeros(len(points)), np.zeros(kernels.SUMS)
    count = kernels.sum_surfaces(s.grid.tiles, points, pose, 0.2, 0.1, off, sums)
    # The kernel takes normals to length 1 in single precision.
    np.testing.assert_allclose(sums[:12], surface_sums(found, SIZE)[:12], rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(sums[12:], surface_sums(found, SIZE)[12:], rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(off[:count], deviations(found), rtol=1e-4, atol=1e-7)
    assert count > 20
    core = np.sort(off[:count])
    core = core[core <= 3.0 * 1.4826 * np.median(core)]
    assert kernels.core_variance(off[:count], 3.0) == pytest.approx(np.mean(core**2))


def sums_of(distances, surface_of):
    """What `sum_surfaces` writes of distances of weight 1 on numbered surfaces, but for the matrices."""
    sums = np.zeros(kernels.SUMS)
    for k in np.unique(surface_of):
        e = distances[surface_of == k]
        sums[kernels.WITHIN] += np.sum((e - e.mean()) ** 2)
        sums[kernels.FREEDOM] += len(e) - 1
        sums[kernels.BETWEEN] += len(e) * e.mean() ** 2
        sums[kernels.EXPECTED] += 1.0
    sums[kernels.WEIGHT], sums[kernels.SURFACES] = len(distances), len(np.unique(surface_of))
    return sums


@pytest.mark.parametrize("noise_m", [0.01, 0.02, 0.03])
def test_noise_that_cells_hide_counts_as_it_moves_the_pose(noise_m):
    """Points of walls that stand anywhere in the cells, each compared with the mean of its cell, as the matcher does.

    The shift that brings the distances' mean to zero scatters by what the noise is said to count.
    """
    rng = np.random.default_rng(0)
    walls = rng.uniform(0.0, SIZE, (400, 1))
    drawn = walls + noise_m * rng.standard_normal((400, 400))
    cells = np.floor(drawn / SIZE)
    numbers = np.arange(-5, 7)
    means = np.array(
        [
            [row[c == n].mean() if (c == n).any() else np.nan for n in numbers]
            for row, c in zip(drawn, cells, strict=True)
        ]
    )

    def distances(x):
        nearest = np.take_along_axis(means, np.floor(x / SIZE).astype(int) + 5, axis=1)
        return np.where(np.isfinite(nearest), x - nearest, 0.0)

    scans = [walls + noise_m * rng.standard_normal((400, 20)) for _ in range(60)]
    slope = np.mean([distances(x + 0.002).mean() - distances(x - 0.002).mean() for x in scans]) / 0.004
    shifts = np.array([-distances(x).mean() / slope for x in scans])
    all_of = np.stack([distances(x).ravel() for x in scans])
    measured = len(all_of[0]) * np.var(shifts)
    said = PointErrors.from_sums(sums_of(all_of[0], np.repeat(np.arange(400), 20)), noise_m**2, SIZE).noise
    assert said == pytest.approx(measured, rel=0.5)  # sixty shifts tell a variance within 18 %
    assert noise_m == 0.01 or said > 2.0 * np.var(all_of[0])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(0.0, 0.01), st.integers(1, 40))
def test_the_surfaces_own_errors_are_found_whatever_the_number_of_points_on_them(seed, surface_m, per_surface):
    rng = np.random.default_rng(seed)
    surface_of = np.repeat(np.arange(300), per_surface + 1)
    distances = surface_m * rng.standard_normal(300)[surface_of] + 0.006 * rng.standard_normal(len(surface_of))
    errors = PointErrors.from_sums(sums_of(distances, surface_of), 0.006**2, 1.0)
    assert errors.noise == pytest.approx(0.006**2, rel=0.25)
    scatter = 5.0 * np.sqrt(2.0 / 300) * (surface_m**2 + 0.006**2 / (per_surface + 1))
    assert errors.surface == pytest.approx(surface_m**2 + LEAST_SURFACE_M**2, abs=scatter + 2e-7)


def test_exact_distances_leave_the_least_noise_and_no_distances_do_too():
    nothing = PointErrors.from_sums(np.zeros(kernels.SUMS), None, SIZE)
    exact = PointErrors.from_sums(sums_of(np.zeros(30), np.repeat(np.arange(10), 3)), 0.0, SIZE)
    for errors in (nothing, exact):
        assert LEAST_NOISE_M**2 <= errors.noise < 1.2 * LEAST_NOISE_M**2
        assert errors.surface == LEAST_SURFACE_M**2


def matches_in_a_building(beams, noise_m, count=12, scans=3):
    """Errors (n, 3) of scans matched on grids of scans at their true poses, and what is said of them (n, 3, 3)."""
    laser = LaserGeometry(beams, -np.pi / 2.0, np.pi / (beams - 1), 16.0)
    building, rng = random_building(3), np.random.default_rng(beams)
    drive = plan_drive(building.route, 0.4, 0.6, 0.4)
    matcher, found = SurfaceMatcher(MatchConfig()), []

    def seen_from(poses):
        ranges = cast_rays(building.walls, poses, laser.bearings_rad(), laser.max_range_m)
        ranges = (ranges + noise_m * rng.standard_normal(ranges.shape)).astype(np.float32)
        offsets = np.arange(len(poses) + 1) * beams
        return ScanPoints(Scans(ranges.ravel(), offsets, np.zeros(len(poses), np.int32), (laser,)), ScanConfig())

    for middle_s in np.linspace(20.0, drive.duration_s - 20.0, count):
        grid, poses = SurfaceGrid(SIZE), drive.at(middle_s + np.linspace(-6.0, 6.0, 40))[0]
        drawn = seen_from(poses)
        for k, pose in enumerate(poses):
            grid.insert(drawn.of(k), np.zeros(3), pose)
        there = drive.at(middle_s + rng.uniform(-4.0, 4.0, scans))[0]
        fresh = seen_from(there)
        for k, pose in enumerate(there):
            points = fresh.of(k)
            match = matcher.match(grid, points, se2.compose(pose, (0.02, -0.02, 0.01)))
            found.append((pose_errors(match.pose[None], pose[None])[0], matcher.uncertainty(grid, points, match)))
    return np.array([error for error, _ in found]), [uncertainty for _, uncertainty in found]


@pytest.mark.parametrize(("beams", "noise_m"), [(181, 0.02), (1441, 0.01), (1441, 0.03)])
def test_covariances_are_right_whatever_the_density_of_beams(beams, noise_m):
    """The same residual variance over the normal matrix, taken as it is, would be 5, 6 and 27 times too small."""
    errors, said = matches_in_a_building(beams, noise_m)
    nees = normalized_errors(errors, np.array([one.covariance for one in said])) / 3.0
    assert 0.4 < nees.mean() < 1.8


def test_dense_beams_renew_more_of_a_grid_than_sparse_ones():
    sparse, dense = (
        np.median([one.renewed for one in matches_in_a_building(beams, 0.01, 3)[1]]) for beams in (181, 721)
    )
    assert 0.01 < sparse < 0.1
    assert dense == pytest.approx(4.0 * sparse, rel=0.3)
    uncertainty = matches_in_a_building(181, 0.01, 1, 1)[1][0]
    assert uncertainty.renewed_by(0) == 0.0
    assert uncertainty.renewed_by(1) == pytest.approx(uncertainty.renewed)
    assert uncertainty.renewed_by(1000) == pytest.approx(1.0)


@pytest.mark.parametrize("beams", [181, 721])
def test_odometry_edges_of_a_drive_have_the_covariance_that_their_errors_have(beams):
    laser = LaserModel(LaserGeometry(beams, -np.pi / 2.0, np.pi / (beams - 1), 16.0), 0.02)
    simulation = simulate(random_building(2), laser, seed=2)
    graph = FrontEnd(simulation.log.scans.geometries, Config()).run(simulation.log)
    truth = simulation.truth[graph.hung.node_scan]
    errors = pose_errors(graph.chains.edges[1:], se2.between(truth[:-1], truth[1:]))
    assert 0.5 < normalized_errors(errors, graph.chains.covariances[1:]).mean() / 3.0 < 1.7


def test_a_scan_that_finds_nothing_is_uncertain_in_every_direction():
    for points in (np.zeros((0, 5)), np.ones((40, 5))):
        said = match_uncertainty(SurfaceGrid(SIZE), points, np.zeros(3), MatchConfig())
        np.testing.assert_allclose(said.covariance, 100.0 * np.eye(3))
        assert said.renewed == 0.0
