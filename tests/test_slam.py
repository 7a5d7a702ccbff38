"""The whole method: consistent results, and logs that it refuses."""

from dataclasses import replace
from types import NoneType

import numpy as np
import pytest

from mapmend.compiling import CompileWatch
from mapmend.config import Config
from mapmend.errors import InputError, MapmendError
from mapmend.evaluation.trajectory import trajectory_errors
from mapmend.geometry.se2 import between
from mapmend.igo.iterate import Iteration
from mapmend.simulation import OdometryModel, corridor_loop, first_scans, simulate
from mapmend.slam import METHODS, build_map


@pytest.fixture(scope="module")
def simulation():
    return first_scans(simulate(corridor_loop(), odometry=OdometryModel(rotation_bias_radpm=0.02), seed=6), 200)


@pytest.fixture(scope="module")
def results(simulation):
    return {method: build_map(simulation.log, method) for method in METHODS}


@pytest.mark.parametrize("method", METHODS)
def test_a_result_hangs_together(results, simulation, method):
    result, n = results[method], len(simulation.log)
    assert result.trajectory.poses.shape == (n, 3)
    np.testing.assert_allclose(result.trajectory.poses[0], 0.0, atol=1e-9)
    assert result.graph.scans is not None
    assert result.graph.stamps_s is not None
    assert result.counts["nodes"] == len(result.graph) == len(result.graph.scans)
    assert result.counts["odometry_edges"] == len(result.graph) - 1
    assert set(result.seconds) == {"match", "map"}
    assert isinstance(result.mended, Iteration if method == "igo" else NoneType)
    # A node stands where the trajectory passes at its stamp.
    rows = np.searchsorted(simulation.log.stamps_s, result.graph.stamps_s)
    np.testing.assert_allclose(result.graph.poses[:, :2], result.trajectory.poses[rows, :2], atol=1e-6)


def test_odometry_is_the_logs_own(results, simulation):
    odometry = simulation.log.odometry
    # Odometry is taken in whole nanometres and nanoradians; half of one, 20 m away, is 1e-8 m.
    np.testing.assert_allclose(results["odometry"].trajectory.poses, between(odometry[0], odometry), atol=2e-8)
    steps = between(results["odometry"].graph.poses[:-1], results["odometry"].graph.poses[1:])
    rows = Config().key_nodes
    far = (np.hypot(steps[:, 0], steps[:, 1]) >= rows.node_every_m) | (np.abs(steps[:, 2]) >= rows.node_every_rad)
    assert far.all()
    assert results["odometry"].chi2_final < 1e-9


def test_matching_is_better_than_odometry(results, simulation):
    stamps = simulation.log.stamps_s
    errors = {
        name: trajectory_errors(stamps, result.trajectory.poses, stamps, simulation.truth).rotation_mean_deg
        for name, result in results.items()
    }
    assert errors["scanmatch"] < 0.5 * errors["odometry"]
    assert errors["go"] < 0.5 * errors["odometry"]
    assert errors["igo"] < 0.5 * errors["odometry"]


def test_without_odometry_the_laser_does(simulation):
    config = Config()
    config = replace(config, motion=replace(config.motion, use_odometry=False))
    still = replace(simulation.log, odometry=np.zeros_like(simulation.log.odometry))
    result = build_map(first_half(still), config=config)
    truth = simulation.truth[: len(still) // 2]
    turned = np.abs(result.trajectory.poses[-1, 2] - between(truth[0], truth[-1])[2])
    assert np.degrees(turned) < 2.0
    with pytest.raises(InputError, match="--no-odometry"):
        build_map(still)
    with pytest.raises(MapmendError, match="needs odometry"):
        build_map(still, "odometry", config)


def first_half(log):
    n = len(log) // 2
    return replace(log, scans=log.scans.select(np.arange(n)), stamps_s=log.stamps_s[:n], odometry=log.odometry[:n])


def test_a_method_that_there_is_not(simulation):
    with pytest.raises(MapmendError, match="magic"):
        build_map(simulation.log, "magic")


def test_progress_is_told_to_the_end(simulation):
    told = {}
    build_map(first_half(simulation.log), progress=lambda stage, done, total: told.__setitem__(stage, (done, total)))
    assert all(done == total for done, total in told.values())
    assert "map" in told


def test_compiling_is_told_once():
    told = []
    watch = CompileWatch(lambda: told.append(1))
    for _ in range(2):
        watch.start()
        watch.start()
        watch.end()
        watch.end()
    assert told == [1]
    assert watch.seconds >= 0.0
