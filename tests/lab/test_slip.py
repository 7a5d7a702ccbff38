"""Logs whose wheels slip on demand: what is reported too much, where, and that all else stays as it was."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.lab.slip import GAP_M, STRAIGHT_RAD, SlipModel, slip_log
from mapmend.scan import LaserGeometry, ScanLog, Scans

CORNERS = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [5.0, 30.0], [5.0, 3.0]])


def log_of(steps, begin=(3.0, -2.0, 1.0)):
    """A log without beams whose odometry makes the steps (n, 3) one after the other."""
    poses = [np.array(begin)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    n = len(poses)
    scans = Scans(
        np.zeros(0, np.float32), np.zeros(n + 1, np.int64), np.zeros(n, np.int32), (LaserGeometry(0, 0, 0, 8),)
    )
    return ScanLog(scans, np.arange(n, dtype=np.float64), np.array(poses), source="drawn")


def round_trip(step_m=0.1):
    """Legs between corners with turns on the spot of 10 steps, and a stop of 5 steps on each leg."""
    steps = []
    heading = 0.0
    for begin, end in pairwise(CORNERS):
        way = end - begin
        turn = se2.wrap_angle(np.arctan2(way[1], way[0]) - heading)
        heading += turn
        steps += [(0.0, 0.0, turn / 10.0)] * (10 if turn else 0)
        count = round(np.hypot(*way) / step_m)
        steps += (
            [(step_m, 0.0, 0.0)] * (count // 2) + [(0.0, 0.0, 0.0)] * 5 + [(step_m, 0.0, 0.0)] * (count - count // 2)
        )
    return log_of(steps)


def steps_of(log):
    return se2.between(log.odometry[:-1], log.odometry[1:])


models = st.builds(
    SlipModel,
    kind=st.sampled_from(["along", "jump"]),
    count=st.integers(0, 8),
    share=st.floats(0.0, 0.9),
    length_m=st.floats(0.5, 6.0),
)


@settings(max_examples=40, deadline=None)
@given(models, st.integers(0, 1000))
def test_only_the_steps_of_slips_change_and_they_report_the_share_too_much(model, seed):
    log = round_trip()
    slipped = slip_log(log, model, seed)
    before, after = steps_of(log), steps_of(slipped.log)
    assert len(slipped.slips) == model.count
    touched = np.zeros(len(before), dtype=bool)
    for slip in slipped.slips:
        rows = slice(slip.first, slip.last)
        assert not touched[rows].any()
        touched[rows] = True
        extra_m = float(np.hypot(*(after - before)[rows, :2].T).sum())
        assert slip.phantom_m == pytest.approx(extra_m, abs=1e-9)
        # A slip begins and ends with a scan: it is longer than asked for by less than a step at either end.
        wanted, step = (model.length_m, 0.0) if model.kind == "jump" else (model.share * model.length_m, 0.1)
        most = wanted + 2.0 * step * model.share / (1.0 - model.share)
        assert wanted - 1e-9 <= slip.phantom_m <= most + 1e-9
    np.testing.assert_allclose(after[~touched], before[~touched], atol=1e-9)
    np.testing.assert_allclose(slipped.log.odometry[0], log.odometry[0])
    assert slipped.log.scans is log.scans
    assert slipped.log.stamps_s is log.stamps_s


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_slips_lie_apart_and_mostly_on_straight_stretches(seed):
    log = round_trip()
    slips = slip_log(log, SlipModel("along", 10, 0.5, 3.0), seed).slips
    path = np.concatenate(([0.0], np.cumsum(np.hypot(*steps_of(log)[:, :2].T))))
    heading = np.concatenate(([0.0], np.cumsum(steps_of(log)[:, 2])))
    assert all(path[b.first] - path[a.last] >= GAP_M for a, b in pairwise(slips))
    straight = [np.ptp(heading[s.first : s.last + 1]) <= STRAIGHT_RAD for s in slips]
    assert sum(straight) >= 5


def test_in_a_turn_too_much_turn_is_reported_and_no_way():
    log = round_trip()
    slipped = slip_log(log, SlipModel("turn", 3, 0.5), seed=4)
    change = steps_of(slipped.log) - steps_of(log)
    np.testing.assert_allclose(change[:, :2], 0.0, atol=1e-9)
    # Each turn of the drive is a right angle to the left or more, and half of what is reported did not happen.
    assert [slip.phantom_rad for slip in slipped.slips] == pytest.approx([np.pi / 2.0] * 3)


def test_the_seed_decides():
    log, model = round_trip(), SlipModel(count=6)
    first, second, other = (slip_log(log, model, seed) for seed in (5, 5, 6))
    assert first.log.odometry.tobytes() == second.log.odometry.tobytes()
    assert first.slips == second.slips
    assert first.slips != other.slips


def test_a_robot_that_backs_up_slips_backwards():
    slipped = slip_log(log_of([(-0.1, 0.0, 0.0)] * 300), SlipModel("jump", 1, length_m=2.0), seed=1)
    (slip,) = slipped.slips
    assert steps_of(slipped.log)[slip.first, 0] == pytest.approx(-2.1)


@pytest.mark.parametrize("wrong", [{"kind": "sideways"}, {"count": -1}, {"share": 1.0}, {"length_m": 0.0}])
def test_what_makes_no_sense_is_refused(wrong):
    with pytest.raises(MapmendError):
        SlipModel(**wrong)


def test_more_slips_than_the_log_holds_are_refused():
    with pytest.raises(MapmendError, match="do not fit"):
        slip_log(log_of([(0.1, 0.0, 0.0)] * 50), SlipModel(count=10), seed=0)
