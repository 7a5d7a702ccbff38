"""Which points are marked as contradicting, and where a region lies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mapmend.consistency.check import check
from mapmend.consistency.regions import contradicting_points
from tests.consistency.scenes import room_graph


@pytest.fixture(scope="module")
def result():
    """One scan of a right map stands elsewhere: it contradicts many others, of which none fails by itself."""
    graph = room_graph(80)
    poses = graph.poses.copy()
    poses[40, 0] += 0.5
    return check(graph.with_poses(poses))


def test_a_lone_wrong_scan_contradicts_scans_that_have_not_failed(result):
    assert np.flatnonzero(result.scans.failed).tolist() == [40]
    owner = np.repeat(np.arange(80), np.diff(result.views.scans.points.offsets))
    assert (result.points & (owner == 40)).any()
    (region,) = result.regions
    assert region.failures > 10
    assert not (result.points[owner == 40]).all()


def test_failed_pairs_without_a_failed_scan_mark_nothing(result):
    none = replace(result.scans, failed=np.zeros(80, np.bool_))
    marked = contradicting_points(result.views, result.pairs, none, np.full(len(result.pairs.pairs), 0.01))
    assert not marked.any()
