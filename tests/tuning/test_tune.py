"""The parameter of the most consistent map: found, reported, and the same for any number of threads."""

from dataclasses import replace

import numpy as np
import pytest

import mapmend
from mapmend.consistency.check import judge_map
from mapmend.consistency.measure import measure_pairs
from mapmend.consistency.visibility import view_scans
from mapmend.errors import MapmendError
from mapmend.graph.optimizer import optimize
from mapmend.graph.robust import KERNELS, kernel_of
from mapmend.graph.starts import along_odometry
from mapmend.tuning import search
from mapmend.tuning import tune as tuning
from mapmend.tuning.solutions import Solution, solve
from tests.consistency.scenes import room_graph
from tests.tuning.graphs import doubtful_room, hopeless_room, room_of_two_valleys


@pytest.fixture(scope="module")
def tuned():
    graph, is_false = doubtful_room()
    return graph, is_false, mapmend.tune(graph)


def farthest_m(poses, graph):
    return np.hypot(*(poses - graph.poses)[:, :2].T).max()


def average_measure(graph):
    """M of the map as it stands, metres, and the number of pairs that overlap."""
    return tuning.average_measure(view_scans(graph.scans, tuning.DEFAULT_CONFIG.consistency).placed(graph.poses))


def test_false_loops_are_switched_off_and_the_map_is_right(tuned):
    graph, is_false, result = tuned
    assert set(np.flatnonzero(is_false)) <= set(result.switched_off)
    assert result.consistent
    assert farthest_m(result.graph.poses, graph) < 0.07
    # The case is one: neither the odometry alone nor all loops together give this map.
    for other in (graph.with_edges(~graph.is_loop), graph):
        bent = optimize(other.with_poses(along_odometry(graph))).poses
        assert farthest_m(bent, graph) > 0.1


def test_no_value_of_a_dense_sweep_is_better_by_more_than_a_hundredth(tuned):
    graph, _, result = tuned
    roots = np.linspace(0.0, 4.0, 41)
    found = solve(graph.with_poses(along_odometry(graph)), "dcs", (roots**2).tolist())
    views = view_scans(graph.scans, tuning.DEFAULT_CONFIG.consistency)
    least = min(measure_pairs(views.placed(s.poses)).measure_m.sum() for s in found)
    assert result.measure_m * result.overlapping <= 1.01 * least


def test_the_result_says_what_it_is(tuned):
    graph, _, result = tuned
    assert result.kernel == "dcs"
    assert np.all(np.diff(result.curve_phi) > 0.0)
    assert result.curve_phi[0] == 0.0
    assert result.curve_phi[-1] == 16.0
    assert result.measure_at(result.phi) == pytest.approx(result.measure_m)
    assert result.curve_m.min() == pytest.approx(result.measure_m, rel=1e-3)
    assert result.measure_at(0.0) > 1.5 * result.measure_m
    assert result.measure_at(0.123) is None
    assert (result.measure_m, result.overlapping) == average_measure(result.graph)
    again = optimize(graph.with_poses(along_odometry(graph)), kernel=kernel_of("dcs", result.phi))
    np.testing.assert_allclose(result.graph.poses, again.poses, atol=1e-12)
    np.testing.assert_array_equal(result.edge_weights, again.edge_weights)
    assert 0.0 <= result.curve_bound <= 2.0 * tuning.TOLERANCE


def test_the_same_for_any_number_of_threads(tuned):
    graph, _, one = tuned
    three = mapmend.tune(graph, threads=3)
    assert three.phi == one.phi
    assert three.measure_m == one.measure_m
    np.testing.assert_array_equal(three.curve_m, one.curve_m)
    np.testing.assert_array_equal(three.graph.poses, one.graph.poses)


def test_a_sample_finds_the_same_map(tuned, monkeypatch):
    graph, _, whole = tuned
    monkeypatch.setattr(tuning, "SAMPLED_POINTS", 600 * 360)
    part = tuning.tune(graph)
    assert part.sampled <= 0.5
    assert part.asked < 0.6 * whole.asked
    np.testing.assert_allclose(part.graph.poses, whole.graph.poses, atol=0.01)


@pytest.mark.parametrize("kernel", [k for k in KERNELS if k != "dcs"])
def test_any_kernel_of_one_parameter(kernel, monkeypatch):
    monkeypatch.setattr(search, "GRID_STEPS", 16)
    monkeypatch.setattr(search, "ROUNDS", 2)
    graph, _ = doubtful_room(nodes=40)
    result = tuning.tune(graph, kernel=kernel)
    assert result.kernel == kernel
    assert result.measure_m == pytest.approx(result.curve_m.min(), rel=tuning.TOLERANCE)
    assert farthest_m(result.graph.poses, graph) < 0.08


def test_where_no_phi_helps_the_verdict_says_so():
    result = mapmend.tune(hopeless_room())
    assert not result.consistent
    assert result.phi == result.least_phi
    assert not any(checked.consistent for checked in result.verdicts)
    assert np.all(np.diff([checked.measure_m for checked in result.verdicts]) >= 0.0)


def with_verdicts(monkeypatch, accepts):
    """Lets the check accept the maps that ``accepts`` does, and no other."""

    def judged(graph, *args, **options):
        return replace(
            judge_map(graph, *args, **options), consistent=accepts(graph), p_value=0.5 if accepts(graph) else 0.0
        )

    monkeypatch.setattr(tuning, "judge_map", judged)


def test_where_the_map_of_least_m_fails_the_lowest_valley_whose_map_passes_is_taken(monkeypatch):
    graph = room_of_two_valleys()
    best = mapmend.tune(graph)
    assert best.phi == best.least_phi
    assert [checked.phi for checked in best.verdicts] == [best.phi]
    with_verdicts(monkeypatch, lambda g: not np.allclose(g.poses, best.graph.poses, atol=1e-6))
    other = mapmend.tune(graph)
    assert other.consistent
    assert other.least_phi == best.phi != other.phi
    assert [checked.consistent for checked in other.verdicts] == [False, True]
    assert other.verdicts[1].phi == other.phi
    assert other.verdicts[1].measure_m == pytest.approx(other.measure_m) == other.measure_at(other.phi)
    assert (other.measure_m, other.overlapping) == average_measure(other.graph)
    # It is a minimum of its own: M rises in between.
    low, high = sorted((other.phi, other.least_phi))
    between = other.curve_m[(other.curve_phi > low) & (other.curve_phi < high)]
    assert between.max() > other.measure_m > other.curve_m.min()
    assert "contradicts itself" in other.notes[0]
    assert f"{best.phi:.4g}" in other.notes[0]


def test_where_none_passes_the_map_of_least_m_is_given(monkeypatch):
    with_verdicts(monkeypatch, lambda g: False)
    result = mapmend.tune(room_of_two_valleys())
    assert not result.consistent
    assert result.phi == result.least_phi
    assert 2 <= len(result.verdicts) <= tuning.MOST_CHECKED
    assert not any("taken is" in note for note in result.notes)


def test_at_phi_0_the_loops_are_left_out_and_all_solves_start_alike():
    graph, _ = doubtful_room()
    start = graph.with_poses(along_odometry(graph))
    nothing, one, same = solve(start, "dcs", [0.0, 1.0, 1.0], threads=2)
    np.testing.assert_allclose(nothing.poses, start.poses, atol=1e-9)
    assert not nothing.edge_weights[graph.is_loop].any()
    assert nothing.edge_weights[~graph.is_loop].all()
    np.testing.assert_array_equal(one.poses, same.poses)


def test_values_that_leave_nodes_loose_are_left_out_and_said():
    graph, _ = doubtful_room(0)
    loose = replace(graph, is_loop=graph.is_loop | (np.arange(len(graph.edges)) == 30))
    found = solve(loose, "dcs", [0.0, 1.0])
    assert isinstance(found[0], MapmendError)
    assert isinstance(found[1], Solution)
    result = mapmend.tune(loose)
    assert "gave no map" in result.notes[0]
    assert result.curve_phi[0] > 0.0


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"scans": None}, "0 of 12 nodes carry a scan"),
        ({"is_loop": np.zeros(12, np.bool_)}, "no loop edges"),
    ],
)
def test_what_can_not_be_tuned_is_refused(change, what):
    with pytest.raises(MapmendError, match=what):
        mapmend.tune(replace(room_graph(12), **change))


def test_unknown_kernels_and_starts_are_refused():
    with pytest.raises(MapmendError, match="kernel must be one of"):
        mapmend.tune(room_graph(12), kernel="none")
    with pytest.raises(MapmendError, match="start must be one of"):
        mapmend.tune(room_graph(12), init="anywhere")
