"""The particle filter on whole drives."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.baselines.gmapping import ParticleFilter, path_graph
from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.geometry import se2
from mapmend.io.read_log import read_log
from mapmend.io.relations import read_relations
from mapmend.lab.odometry_jumps import JumpModel, with_jumps
from mapmend.slam import build_map
from tests.front_end.logs import BENT, drive, errors_of
from tests.real_data import data_path

FEW = replace(Config(), gmapping=replace(Config().gmapping, particles=8))


@pytest.fixture(scope="module")
def simulation():
    return drive(2, odometry=BENT)


@pytest.fixture(scope="module")
def filtered(simulation):
    particles = ParticleFilter(simulation.log, FEW)
    particles.run()
    return particles


def test_a_bent_drive_comes_out_straight(simulation, filtered):
    _, poses = path_graph(filtered)
    odometry = simulation.log.odometry
    assert errors_of(simulation, se2.between(odometry[0], odometry)).translation_mean_m > 0.5
    # With eight particles, 0.03 to 0.14 m by seed: how far the best of them is off where the loop closes.
    errors = errors_of(simulation, poses)
    assert errors.translation_mean_m < 0.15
    assert errors.rotation_mean_deg < 1.0


def test_the_graph_is_the_best_particles_path(filtered):
    graph, poses = path_graph(filtered)
    path, _ = filtered.best_path()
    np.testing.assert_allclose(graph.poses, path)
    rows = [update.scan for update in filtered.updates]
    np.testing.assert_allclose(poses[rows], path, atol=1e-9)
    assert np.abs(path[:, 2]).max() <= np.pi
    np.testing.assert_allclose(graph.measurements, se2.between(path[:-1], path[1:]), atol=1e-12)
    assert np.linalg.eigvalsh(graph.information).min() > 0.0
    assert not graph.is_loop.any()


def test_scans_between_updates_do_not_jump(simulation, filtered):
    """Steps between scans are off by the proposal's noise at updates: 0.02 m, once 0.05 m. With jumps: 0.05, 0.07 m."""
    _, poses = path_graph(filtered)
    true_steps = se2.between(simulation.truth[:-1], simulation.truth[1:])
    off = se2.between(true_steps, se2.between(poses[:-1], poses[1:]))
    length_m = np.hypot(off[:, 0], off[:, 1])
    assert np.quantile(length_m, 0.995) < 0.03
    assert length_m.max() < 0.06
    assert np.abs(off[:, 2]).max() < 0.02


def test_a_path_is_one_of_ancestors(filtered):
    """Each update's pose on the best path is the one that the next was proposed from: a proposal apart, no farther."""
    assert filtered.resamplings > 0
    path, _ = filtered.best_path()
    tracked = np.array([update.tracked for update in filtered.updates[1:]])
    off = se2.between(tracked, se2.between(path[:-1], path[1:]))
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.3


def test_threads_and_seeds(simulation, filtered):
    two = ParticleFilter(simulation.log, FEW, threads=2)
    two.run()
    np.testing.assert_array_equal(path_graph(filtered)[1], path_graph(two)[1])
    np.testing.assert_array_equal(filtered.log_weights, two.log_weights)
    other = ParticleFilter(simulation.log, replace(FEW, seed=1))
    other.run()
    assert not np.array_equal(path_graph(filtered)[1], path_graph(other)[1])


def test_updates_come_as_often_as_they_are_asked_for(simulation, filtered):
    settings = FEW.gmapping
    steps = np.abs(np.array([update.tracked for update in filtered.updates[1:]]))
    way, turn = np.hypot(steps[:, 0], steps[:, 1]), steps[:, 2]
    assert way.max() < 1.3 * settings.linear_update_m
    assert turn.max() < 1.5 * settings.angular_update_rad


def test_without_odometry_the_laser_does(simulation):
    still = replace(simulation.log, odometry=np.zeros_like(simulation.log.odometry))
    config = replace(FEW, motion=replace(FEW.motion, use_odometry=False))
    particles = ParticleFilter(still, config)
    particles.run()
    assert errors_of(simulation, path_graph(particles)[1]).translation_mean_m < 0.1


def jumped_error_m(log, model, seed):
    """The mean error of the filter on a log that gets jumps, and how many steps it refuted."""
    jumped, _ = with_jumps(log, model, seed)
    particles = ParticleFilter(jumped, replace(FEW, seed=seed))
    particles.run()
    return path_graph(particles)[1], particles.follower.refuted


@pytest.mark.parametrize(
    "model",
    [
        JumpModel(3, 2.0, 1.0),
        JumpModel(1, 5.0, np.pi),
        JumpModel(10, 0.5, 2.0),
        JumpModel(3, 1.5, 0.0, "turning"),
    ],
)
def test_jumps_of_the_odometry_lose_nobody(simulation, model):
    """Before, one jump of 2 m and 1 rad ended in an error of several metres; the drive without jumps has 0.05 m."""
    poses, refuted = jumped_error_m(simulation.log, model, 1)
    assert errors_of(simulation, poses).translation_mean_m < 0.2
    assert refuted == model.count


@pytest.mark.parametrize("model", [JumpModel(1, 1.0, 0.5), JumpModel(3, 0.0, 1.0), JumpModel(10, 1.0, 1.0)])
def test_jumps_hardly_longer_than_the_steps_of_a_sparse_log(simulation, model):
    """With a scan every 0.3 m, the step alone does not tell a jump of 1 m: the scans must."""
    rows = np.arange(0, len(simulation.log), 4)
    log = simulation.log
    sparse = replace(log, scans=log.scans.select(rows), stamps_s=log.stamps_s[rows], odometry=log.odometry[rows])
    poses, _ = jumped_error_m(sparse, model, 1)
    errors = trajectory_errors(sparse.stamps_s, poses, log.stamps_s, simulation.truth)
    assert errors.translation_mean_m < 0.35


def test_a_gap_in_the_log_is_no_jump(simulation):
    """The robot drove on where scans are missing: the pause between the stamps says that its long step happened."""
    log, rows = simulation.log, np.delete(np.arange(len(simulation.log)), np.arange(401, 421))
    gap = replace(log, scans=log.scans.select(rows), stamps_s=log.stamps_s[rows], odometry=log.odometry[rows])
    particles = ParticleFilter(gap, FEW)
    particles.run()
    assert particles.follower.refuted == 0
    errors = trajectory_errors(gap.stamps_s, path_graph(particles)[1], log.stamps_s, simulation.truth)
    assert errors.translation_mean_m < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("model", [JumpModel(0), JumpModel(3, 2.0, 1.0)])
@pytest.mark.parametrize(("name", "most_m"), [("intel", 0.03), ("fr079", 0.04)])
def test_real_logs(name, most_m, model):
    """Medians over ten seeds are below 0.023 m and 0.034 m (benchmarks/gmapping.py)."""
    log, _ = with_jumps(read_log(data_path(f"logs/{name}.clf.bz2")), model, 1)
    relations = read_relations(data_path(f"relations/{name}.relations"))
    result = build_map(log, "gmapping", threads=2)
    errors = relation_errors(
        log.stamps_s, result.trajectory.poses, relations.t1_s, relations.t2_s, relations.relative_poses
    )
    assert errors.translation_mean_m < most_m
