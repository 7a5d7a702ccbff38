"""Logs whose odometry jumps: what is reported too much, where, and that all else stays as it was."""

import numpy as np
import pytest

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.lab.odometry_jumps import EDGE_SCANS, PLACES, STANDING_M, TURNING_RAD, JumpModel, with_jumps
from tests.lab.test_slip import round_trip, steps_of


@pytest.mark.parametrize("place", PLACES)
def test_jumps_are_where_and_as_long_as_asked(place):
    log = round_trip()
    model = JumpModel(4, 2.0, 1.0, place)
    jumped, scans = with_jumps(log, model, 3)
    rows = np.array(scans) - 1
    assert len(set(scans)) == 4
    assert rows.min() >= EDGE_SCANS
    assert rows.max() < len(log) - 1 - EDGE_SCANS
    extra = se2.between(np.zeros(3), se2.compose(steps_of(jumped), se2.inverse(steps_of(log))))
    assert np.abs(np.delete(extra, rows, axis=0)).max() < 1e-9
    np.testing.assert_allclose(np.hypot(*extra[rows, :2].T), 2.0)
    np.testing.assert_allclose(np.abs(extra[rows, 2]), 1.0)
    was = steps_of(log)[rows]
    if place == "standing":
        assert np.hypot(was[:, 0], was[:, 1]).max() < STANDING_M
    if place == "turning":
        assert np.abs(was[:, 2]).min() >= TURNING_RAD
    assert jumped.scans is log.scans
    np.testing.assert_array_equal(jumped.stamps_s, log.stamps_s)


def test_the_same_seed_gives_the_same_log():
    log = round_trip()
    one, again, other = (with_jumps(log, JumpModel(), seed)[0].odometry for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    np.testing.assert_array_equal(with_jumps(log, JumpModel(0), 1)[0].odometry, log.odometry)


def test_what_cannot_be_is_refused():
    with pytest.raises(MapmendError, match="there is no place 'flying'"):
        JumpModel(place="flying")
    with pytest.raises(MapmendError, match="count >= 0"):
        JumpModel(-1)
    with pytest.raises(MapmendError, match="ask for fewer"):
        with_jumps(round_trip(), JumpModel(10_000), 1)
