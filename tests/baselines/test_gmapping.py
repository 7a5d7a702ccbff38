"""The particle filter on whole drives."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.baselines.gmapping import ParticleFilter, path_graph
from mapmend.config import Config
from mapmend.evaluation.relations import relation_errors
from mapmend.geometry import se2
from mapmend.io.read_log import read_log
from mapmend.io.relations import read_relations
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
    errors = errors_of(simulation, poses)
    assert errors.translation_mean_m < 0.08
    assert errors.rotation_mean_deg < 1.0


def test_the_graph_is_the_best_particles_path(filtered):
    graph, poses = path_graph(filtered)
    path, _ = filtered.best_path()
    np.testing.assert_allclose(graph.poses, path)
    rows = [update.scan for update in filtered.updates]
    np.testing.assert_allclose(se2.between(poses[rows], path), 0.0, atol=1e-9)
    np.testing.assert_allclose(graph.measurements, se2.between(path[:-1], path[1:]), atol=1e-12)
    assert np.linalg.eigvalsh(graph.information).min() > 0.0
    assert not graph.is_loop.any()


def test_scans_between_updates_do_not_jump(simulation, filtered):
    """A step between two scans is off by what the proposal's noise makes of it, 0.033 m; 0.066 m where scans jumped."""
    _, poses = path_graph(filtered)
    true_steps = se2.between(simulation.truth[:-1], simulation.truth[1:])
    off = se2.between(true_steps, se2.between(poses[:-1], poses[1:]))
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.045
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


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most_m"), [("intel", 0.033), ("fr079", 0.04)])
def test_real_logs(name, most_m):
    log = read_log(data_path(f"logs/{name}.clf.bz2"))
    relations = read_relations(data_path(f"relations/{name}.relations"))
    result = build_map(log, "gmapping", threads=2)
    errors = relation_errors(
        log.stamps_s, result.trajectory.poses, relations.t1_s, relations.t2_s, relations.relative_poses
    )
    assert errors.translation_mean_m < most_m
