"""The sums over pairs: equal to those of all pairs, and never farther off than they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.config import ConsistencyConfig
from mapmend.consistency.measure import measure, measure_pairs
from mapmend.consistency.visibility import view_scans
from mapmend.tuning import _kernels
from mapmend.tuning.pair_sample import PairSample, view_circles
from tests.consistency.scenes import LASERS, random_readings, room_graph, scans_of

CONFIG = ConsistencyConfig()


def scattered(seed, spread_m=3.0):
    """A scan of each laser, anywhere."""
    rng = np.random.default_rng(seed)
    scans = scans_of(LASERS, [random_readings(rng, laser.beam_count) for laser in LASERS])
    poses = np.column_stack((rng.uniform(-spread_m, spread_m, (len(LASERS), 2)), rng.uniform(-3.0, 3.0, len(LASERS))))
    return rng, scans, poses


def all_pairs(n):
    return np.stack(np.triu_indices(n, 1), axis=1).astype(np.int64)


@given(st.integers(0, 10**6), st.sampled_from([1e-4, 1e-2, 0.3, 2.0]))
@settings(max_examples=30, deadline=None)
def test_no_measure_changes_by_more_than_the_bound(seed, size):
    rng, scans, poses = scattered(seed)
    moved = poses + size * rng.standard_normal(poses.shape)
    views = view_scans(scans, CONFIG)
    before, after = views.placed(poses), views.placed(moved)
    pairs = all_pairs(len(scans))
    sample = PairSample(views, 1)
    kept, now = np.full((len(pairs), 4), np.nan), np.empty((len(pairs), 4))
    bounds = np.empty(len(pairs))
    _kernels.change_bounds(pairs, before.lasers, sample.sums, kept, now, bounds)
    assert np.isinf(bounds).all()
    kept = now.copy()
    _kernels.change_bounds(pairs, after.lasers, sample.sums, kept, now, bounds)
    change = np.abs(measure(after, pairs)[:, 1] - measure(before, pairs)[:, 1])
    assert np.all(change <= bounds * (1.0 + 1e-9) + 1e-9)
    # A bound that says nothing would do too: this one is the points' motion.
    motion = np.hypot(*(moved - poses)[:, :2].T)[pairs].sum(axis=1) + 40.0 * np.abs((moved - poses)[:, 2])[pairs].sum(1)
    assert np.all(bounds <= 2.0 * sample.sums[pairs, 0].sum(axis=1) * motion + 1e-9)


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_pairs_whose_circles_are_apart_have_nothing_in_common(seed):
    _, scans, poses = scattered(seed, spread_m=12.0)
    views = view_scans(scans, CONFIG).placed(poses)
    pairs = all_pairs(len(scans))
    circles, lasers = view_circles(views.scans), views.lasers[None]
    centres = np.empty((1, len(scans), 2))
    _kernels.place_circles(lasers, circles, centres)
    apart = np.hypot(*(centres[0, pairs[:, 0]] - centres[0, pairs[:, 1]]).T) > circles[pairs, 2].sum(axis=1)
    assert not measure(views, pairs)[apart, 0].any()
    listed = np.empty((len(pairs), 2), np.int64)
    count = _kernels.sampled_pairs((0, len(scans)), 1, centres, circles, listed)
    np.testing.assert_array_equal(listed[:count], pairs[~apart])


def wobbling(graph, maps, step_m):
    """The graph's map again and again, one node after the other displaced for good."""
    rng = np.random.default_rng(3)
    poses = [graph.poses.copy()]
    for _ in range(maps - 1):
        following = poses[-1].copy()
        following[rng.integers(len(graph)) :, :2] += step_m * rng.standard_normal(2)
        poses.append(following)
    return poses


def exact_sums(graph, poses):
    views = view_scans(graph.scans, CONFIG)
    return np.array([measure_pairs(views.placed(p)).measure_m.sum() for p in poses])


ROUNDING_M = 1e-9


@pytest.mark.parametrize("tolerance_m", [-1.0, ROUNDING_M])
def test_without_tolerance_the_sums_are_those_of_all_pairs(tolerance_m):
    graph = room_graph(30)
    poses = wobbling(graph, 5, 0.05)
    sample = PairSample(view_scans(graph.scans, CONFIG), 1)
    found = sample.evaluate(poses, tolerance_m)
    np.testing.assert_allclose(found.sum_m, exact_sums(graph, poses), rtol=1e-9)
    # Of two scans on one side of the displaced node, neither moved relative to the other.
    assert found.measured == found.asked if tolerance_m < 0.0 else found.measured < 0.8 * found.asked


def test_with_a_tolerance_fewer_are_measured_and_the_sums_stay_within_the_bound():
    graph = room_graph(30)
    poses = wobbling(graph, 8, 0.0002)
    sample = PairSample(view_scans(graph.scans, CONFIG), 1)
    found = sample.evaluate(poses, 0.05)
    off = np.abs(found.sum_m - exact_sums(graph, poses))
    assert np.all(off <= found.bound_m + 1e-9)
    assert found.bound_m.max() <= 0.05 * len(sample.pairs)
    assert found.bound_m.max() > 0.0
    assert found.measured < 0.6 * found.asked


def test_pairs_are_remembered_from_call_to_call():
    graph = room_graph(30)
    poses = wobbling(graph, 3, 0.05)
    sample = PairSample(view_scans(graph.scans, CONFIG), 1)
    first = sample.evaluate(poses, ROUNDING_M)
    again = sample.evaluate([poses[-1]], ROUNDING_M)
    assert again.measured == 0
    assert again.sum_m[0] == first.sum_m[-1]


def test_a_sample_holds_its_share_of_all_pairs_evenly():
    graph = room_graph(120)
    views = view_scans(graph.scans, CONFIG)
    whole, part = PairSample(views, 1), PairSample(views, 8)
    all_of_them = whole.evaluate([graph.poses], -1.0)
    some = part.evaluate([graph.poses], -1.0)
    assert len(part.pairs) == pytest.approx(len(whole.pairs) / 8, rel=0.1)
    assert 8.0 * some.sum_m[0] == pytest.approx(all_of_them.sum_m[0], rel=0.15)
    assert len(np.unique(part.pairs[:, 0])) > 100


def test_the_same_for_any_number_of_threads():
    graph = room_graph(100)
    poses = wobbling(graph, 4, 0.001)
    results = []
    for threads in (1, 3):
        sample = PairSample(view_scans(graph.scans, CONFIG), 1)
        results.append(sample.evaluate(poses, 0.01, threads=threads))
    np.testing.assert_array_equal(results[0].sum_m, results[1].sum_m)
    np.testing.assert_array_equal(results[0].bound_m, results[1].bound_m)
    assert results[0].measured == results[1].measured
