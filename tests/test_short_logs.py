"""Logs of a few scans, whose graphs have one node or two: every method maps them; check and tune answer or say why."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapmend.config import Config
from mapmend.consistency.check import check
from mapmend.errors import MapmendError
from mapmend.geometry.se2 import between
from mapmend.simulation import OdometryModel, corridor_loop, simulate
from mapmend.slam import METHODS, build_map
from mapmend.tuning.tune import tune

FEW = (2, 3, 4, 5, 6, 7, 8, 10, 14, 20, 30, 40)
SCARCE = (2, 3, 8, 20)
"""gmapping takes longer, and has no window over the nodes."""
FIRST_SCAN = 5
BIAS_RADPM = 0.02


@pytest.fixture(scope="module")
def simulation():
    return simulate(corridor_loop(), odometry=OdometryModel(rotation_bias_radpm=BIAS_RADPM), seed=6)


def cut(simulation, count: int, every: int):
    """So many scans, and where the robot was at each, seen from the first."""
    log, rows = simulation.log, FIRST_SCAN + every * np.arange(count)
    part = replace(log, scans=log.scans.select(rows), stamps_s=log.stamps_s[rows], odometry=log.odometry[rows])
    return part, between(simulation.truth[rows[0]], simulation.truth[rows])


def settings(use_odometry: bool) -> Config:
    config = Config()
    return replace(config, motion=replace(config.motion, use_odometry=use_odometry))


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("use_odometry", [True, False])
@pytest.mark.parametrize("method", METHODS)
def test_a_short_log_is_mapped_and_its_map_can_be_checked(simulation, method, use_odometry, every):
    if method == "odometry" and not use_odometry:
        pytest.skip("refused, as test_slam says")
    config, nodes = settings(use_odometry), set()
    for count in SCARCE if method == "gmapping" else FEW:
        log, truth = cut(simulation, count, every)
        result = build_map(log, method, config)
        nodes.add(len(result.graph))
        assert result.trajectory.poses.shape == (count, 3)
        off, way_m = result.trajectory.poses - truth, float(np.hypot(*truth[-1, :2]))
        drift_m = 0.5 * BIAS_RADPM * way_m**2 if method == "odometry" else 0.0
        assert np.abs(off[:, :2]).max() < 0.1 + 0.02 * way_m + drift_m  # two cells, and 2 % of the way
        if len(result.graph) == 1:
            with pytest.raises(MapmendError, match="1 of 1 nodes carry a scan; a check compares at least two"):
                check(result.graph, config)
        else:
            assert 0.0 <= check(result.graph, config).p_value <= 1.0
        if not result.graph.is_loop.any():
            with pytest.raises(MapmendError, match=r"1 of 1 nodes|no loop edges"):
                tune(result.graph, config)
    assert nodes >= ({1, 2} if every == 1 else {2})
