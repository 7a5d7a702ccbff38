"""Relocation on an old part of the map, from farther away than the reach of the loop search."""

from dataclasses import replace

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.front_end.relocation import Relocation
from mapmend.geometry import se2
from tests.front_end.logs import drive
from tests.scan_graph.graphs import graph_of

# A building is some 100 m of trajectory: let drift grow faster than it does.
CONFIG = replace(Config(), loops=replace(Config().loops, drift_per_m=0.2))
ADRIFT = np.array([22.0, -17.0, 0.4])


def back_again(building, adrift, config=CONFIG):
    """Relocation after a drive through a building and the first metres of the same drive again, ``adrift`` (3,)."""
    simulation = drive(building)
    scans = np.arange(0, len(simulation.log), 4)
    rows = np.concatenate((scans, scans[: len(scans) // 4]))
    log = replace(
        simulation.log,
        scans=simulation.log.scans.select(rows),
        stamps_s=np.arange(len(rows), dtype=float),
        odometry=simulation.log.odometry[rows],
    )
    poses = simulation.truth[rows]
    poses[len(scans) :] = se2.compose(adrift, poses[len(scans) :])
    found = Relocation(graph_of(log, poses, np.eye(3) * 1e-6, config=config)).find()
    return found, simulation.truth[rows[-1]]


@pytest.mark.parametrize("building", range(5))
def test_a_robot_adrift_by_28_metres_is_found(building):
    found, true = back_again(building, ADRIFT)
    assert found is not None
    error = se2.between(true, found)
    assert np.hypot(error[0], error[1]) < 0.03
    assert abs(error[2]) < 0.01


def test_drift_within_the_reach_of_the_loop_search_is_left_to_that():
    assert back_again(0, np.array([3.0, 0.0, 0.0]), Config())[0] is None


def test_nothing_is_found_where_the_old_map_is_farther_than_drift_carries():
    far = replace(CONFIG, loops=replace(CONFIG.loops, farthest_m=12.0))
    assert back_again(1, np.array([90.0, 0.0, 0.0]), far)[0] is None
