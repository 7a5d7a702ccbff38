"""The pairwise measure against its definition, MC (1) and (2), all edge cases of the polygon included."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.config import ConsistencyConfig
from mapmend.consistency.measure import measure, measure_pairs
from mapmend.consistency.pairs import find_overlaps
from mapmend.consistency.visibility import view_scans
from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.io.reader import read
from mapmend.scan import LaserGeometry
from tests.consistency.scenes import HALF_CIRCLE, LASERS, random_readings, room_graph, scans_of
from tests.real_data import data_path
from tests.reference import consistency_measure as plain

CONFIG = ConsistencyConfig()
BOTH = np.array([(0, 1)])


def measured(scans, poses, config=CONFIG):
    """n_ij and M_ij of scans 0 and 1."""
    n, total, *_ = measure(view_scans(scans, config).placed(np.asarray(poses, dtype=np.float64)), BOTH)[0]
    return n, total


def test_lasers_of_many_beams_have_wedges_of_their_own():
    """More beams than 16 bits count."""
    geometry = LaserGeometry(40_001, -np.pi / 2.0, np.pi / 40_000.0, 20.0)
    scans = scans_of((geometry,), [np.full(40_001, 3.0)])
    wedges = view_scans(scans, CONFIG).beams.wedges
    assert wedges.min() >= 0
    assert wedges.max() > 2**15


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(LASERS), st.sampled_from(LASERS))
def test_the_measure_is_that_of_the_definition(seed, first, second):
    rng = np.random.default_rng(seed)
    scans = scans_of((first, second), [random_readings(rng, g.beam_count) for g in (first, second)])
    poses = rng.uniform((-1.5, -1.5, -4.0), (1.5, 1.5, 4.0), (2, 3))
    n, total, _ = plain.pair_measure(scans, poses, 0, 1, CONFIG)
    got_n, got = measured(scans, poses)
    assert got_n == n
    assert got == pytest.approx(total, abs=1e-9)


@pytest.mark.parametrize("name", ["intel.toro.gz", "fr079.toro.gz"])
def test_the_measure_is_that_of_the_definition_on_real_scans(name):
    graph = read(data_path(f"scangraphs/{name}"))
    views = view_scans(graph.scans, CONFIG).placed(graph.poses)
    pairs = find_overlaps(views.boxes()).listed(0, 200)
    pairs = pairs[np.random.default_rng(1).choice(len(pairs), 8, replace=False)]
    for (i, j), (n, total, *_) in zip(pairs, measure(views, pairs), strict=True):
        expected_n, expected, _ = plain.pair_measure(graph.scans, graph.poses, i, j, CONFIG)
        assert n == expected_n
        assert total == pytest.approx(expected, abs=1e-9)


def test_the_largest_depths_are_left_out():
    graph = room_graph()
    poses = graph.poses + np.where(np.arange(12)[:, None] == 11, (0.3, 0.0, 0.0), 0.0)
    views = view_scans(graph.scans, CONFIG).placed(poses)
    _, _, distances = plain.pair_measure(graph.scans, poses, 0, 11, CONFIG)
    for drop, left_out in (
        ((10, 0.0), 10),
        ((0, 0.25), int(np.ceil(0.25 * len(distances)))),
        ((10**6, 0.0), len(distances)),
    ):
        _, _, kept, kept_m = measure(views, np.array([(0, 11)]), drop)[0]
        assert kept == len(distances) - left_out
        assert kept_m == pytest.approx(sum(sorted(distances)[: int(kept)]), abs=1e-9)


@pytest.mark.parametrize("geometry", LASERS)
def test_scans_without_returns_contradict_nothing(geometry):
    nothing = np.full(geometry.beam_count, np.inf)
    scans = scans_of((geometry, geometry), [nothing, nothing])
    assert measured(scans, np.zeros((2, 3))) == (0, 0.0)
    walls = scans_of((geometry, HALF_CIRCLE), [nothing, np.full(60, 2.0)])
    assert measured(walls, np.zeros((2, 3))) == (0, 0.0)


def test_a_single_return_sees_no_area_but_can_lie_in_one():
    lonely = np.full(60, np.inf)
    lonely[30] = 1.0
    scans = scans_of((HALF_CIRCLE, HALF_CIRCLE), [lonely, np.full(60, 2.0)])
    n, depth = measured(scans, np.zeros((2, 3)))
    assert n == 1
    assert depth == pytest.approx(1.0, abs=2e-3)  # the arc's chords are slightly nearer, the laser exactly 1 m away
    assert measured(scans_of((HALF_CIRCLE, HALF_CIRCLE), [lonely, lonely]), np.zeros((2, 3))) == (0, 0.0)


@pytest.mark.parametrize("geometry", LASERS)
def test_points_on_the_boundary_are_not_inside(geometry):
    # The same scan twice at the same place: every end point is a corner of the other's polygon.
    readings = random_readings(np.random.default_rng(3), geometry.beam_count)
    readings[72:] = readings[: max(len(readings) - 72, 0)]  # beams beyond a full turn repeat the first readings
    scans = scans_of((geometry, geometry), [readings, readings])
    _, total = measured(scans, [(0.0, 0.0, 0.0)] * 2)
    assert total == pytest.approx(0.0, abs=1e-9)


def test_a_laser_that_looks_all_around_has_free_space_behind_it():
    around = LaserGeometry(72, -np.pi, np.pi / 36.0, 20.0)
    lonely = np.full(60, np.inf)
    lonely[30] = 0.5
    scans = scans_of((around, HALF_CIRCLE), [np.full(72, 3.0), lonely])
    behind = [(0.0, 0.0, 0.0), (-1.0, 0.0, np.pi)]
    assert measured(scans, behind)[0] == 1
    half = scans_of((HALF_CIRCLE, HALF_CIRCLE), [np.full(60, 3.0), lonely])
    assert measured(half, behind)[0] == 0


def test_the_laser_itself_is_inside_where_it_looks_all_around():
    around = LaserGeometry(72, -np.pi, np.pi / 36.0, 20.0)
    ahead = np.full(60, np.inf)
    ahead[0] = 1.0
    # The one end point lies at the other's laser.
    place = se2.inverse(np.array([np.cos(-np.pi / 2.0), np.sin(-np.pi / 2.0), 0.0]))
    scans = scans_of((around, HALF_CIRCLE), [np.full(72, 3.0), ahead])
    n, depth = measured(scans, [(0.0, 0.0, 0.0), place])
    assert n == 1
    assert depth == pytest.approx(3.0 * np.cos(np.pi / 72.0), abs=1e-6)


def test_a_beam_without_return_says_nothing_of_free_space():
    seen = np.full(60, 3.0)
    seen[20:40] = np.inf
    lonely = np.full(60, np.inf)
    lonely[30] = 1.0
    assert measured(scans_of((HALF_CIRCLE, HALF_CIRCLE), [seen, lonely]), np.zeros((2, 3))) == (0, 0.0)


def test_a_far_reading_frees_the_way_and_is_no_point():
    far = np.full(60, 15.0)
    lonely = np.full(60, np.inf)
    lonely[30] = 7.0
    n, _ = measured(scans_of((HALF_CIRCLE, HALF_CIRCLE), [far, lonely]), np.zeros((2, 3)))
    assert n == 1
    lonely[30] = 7.0
    near = replace(CONFIG, max_range_m=6.0)
    assert measured(scans_of((HALF_CIRCLE, HALF_CIRCLE), [far, lonely]), np.zeros((2, 3)), near) == (0, 0.0)


@given(st.integers(0, 10**6), st.tuples(*[st.floats(-50.0, 50.0)] * 2, st.floats(-7.0, 7.0)))
@settings(max_examples=30, deadline=None)
def test_the_measure_asks_nothing_of_the_frame(seed, motion):
    rng = np.random.default_rng(seed)
    scans = scans_of(LASERS[:2], [random_readings(rng, g.beam_count) for g in LASERS[:2]])
    poses = rng.uniform((-1.5, -1.5, -4.0), (1.5, 1.5, 4.0), (2, 3))
    here, there = measured(scans, poses), measured(scans, se2.compose(np.array(motion), poses))
    assert here[0] == there[0]
    assert here[1] == pytest.approx(there[1], abs=1e-9)


@given(st.integers(0, 10**6), st.integers(0, 60), st.sampled_from((1.0, 30.0, 1e5)))
@settings(max_examples=60, deadline=None)
def test_all_boxes_that_overlap_are_found(seed, count, spread):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-spread, spread, (count, 2))
    boxes = np.hstack((low, low + rng.uniform(0.0, 8.0, (count, 2))))
    boxes[rng.random(count) < 0.1] = (np.inf, np.inf, -np.inf, -np.inf)
    overlaps = find_overlaps(boxes)
    listed = [tuple(pair) for piece in overlaps.pieces(7) for pair in overlaps.listed(*piece).tolist()]
    assert listed == plain.overlapping_pairs(boxes)
    assert overlaps.total == len(listed)


def test_the_same_bytes_for_any_number_of_threads():
    graph = room_graph(60)
    views = view_scans(graph.scans, CONFIG).placed(graph.poses)
    one, four = (measure_pairs(views, 5, (10, 0.1), threads) for threads in (1, 4))
    for name in ("pairs", "points", "measure_m", "kept", "kept_m"):
        np.testing.assert_array_equal(getattr(one, name), getattr(four, name))
    assert one.overlapping == four.overlapping


def test_a_scan_without_beams_overlaps_with_nothing():
    scans = scans_of((HALF_CIRCLE,) * 3, [np.full(60, 2.0), [], np.full(60, 2.0)])
    views = view_scans(scans, CONFIG).placed(np.zeros((3, 3)))
    assert measure_pairs(views).pairs.tolist() == [[0, 2]]


def test_lasers_that_see_nothing_between_their_beams_are_refused():
    scans = scans_of((LaserGeometry(2, 0.0, 3.2, 20.0),), [(1.0, 1.0)])
    with pytest.raises(MapmendError, match="apart"):
        view_scans(scans, CONFIG)


def test_marked_points_are_those_that_lie_so_deep():
    from mapmend.consistency import _kernels

    graph = room_graph(6)
    poses = graph.poses + np.arange(6)[:, None] * np.array([0.1, 0.0, 0.0])
    views = view_scans(graph.scans, CONFIG).placed(poses)
    pairs, least = np.array([(0, 5), (2, 3)]), np.array([0.05, 0.02])
    seen = views.scans
    marks = np.zeros(len(seen.points.xy), np.int64)
    _kernels.mark_points(pairs, least, seen.polygons, seen.points, views.lasers, seen.beams, marks)
    expected = np.zeros(len(seen.points.xy), np.int64)
    for (i, j), depth in zip(pairs.tolist(), least, strict=True):
        for a, b in ((i, j), (j, i)):
            polygon = plain.visibility_polygon(graph.scans.ranges_of(a), graph.scans.geometry_of(a), poses[a], CONFIG)
            rows = range(seen.points.offsets[b], seen.points.offsets[b + 1])
            for row, point in zip(rows, views.points_in_map()[rows.start : rows.stop], strict=True):
                distances = plain.inconsistency_distances([point], polygon)
                expected[row] += bool(distances) and distances[0] >= depth
    assert expected.sum() > 20
    np.testing.assert_array_equal(marks, expected)


@pytest.mark.parametrize("geometry", LASERS)
def test_no_polygon_reaches_farther_in_a_sector_than_is_noted(geometry):
    from mapmend.consistency import _kernels

    rng = np.random.default_rng(5)
    views = view_scans(scans_of((geometry,), [random_readings(rng, geometry.beam_count)]), CONFIG)
    polygon = views.polygons.corners[:2, : views.beams.counts[0]].T
    limits, wide = views.polygons.limits[0], views.polygons.group_limits[0]
    for begin, end in plain.sides(polygon):
        for x, y in begin + np.linspace(0.0, 1.0, 50)[:, None] * (end - begin):
            assert x * x + y * y <= limits[_kernels.sector_of(x, y, _kernels.SECTORS)] * (1.0 + 1e-7)
            for turn in np.linspace(0.0, 2.0 * np.pi, 12):
                # The middle of a group one of whose points is on the polygon.
                far_x, far_y = np.array((x, y)) + _kernels.GROUP_RADIUS_M * np.array((np.cos(turn), np.sin(turn)))
                assert far_x**2 + far_y**2 <= wide[_kernels.sector_of(far_x, far_y, _kernels.WIDE_SECTORS)]
    assert limits.max() < 8.1**2
    assert wide.max() < 8.6**2


@given(st.integers(0, 10**6), st.floats(0.01, 20.0))
@settings(max_examples=50, deadline=None)
def test_sectors_in_float32_are_those_of_float64_or_their_neighbours(seed, distance):
    from mapmend.consistency import _kernels

    angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, 40)
    xy = distance * np.stack((np.cos(angles), np.sin(angles)))
    sectors, squares = np.empty(40, np.int32), np.empty(40, np.float32)
    frame = tuple(np.float32(v) for v in (0.0, 0.0, 1.0, 0.0))
    _kernels.sectors_of(frame, xy.astype(np.float32), 0, 40, _kernels.SECTORS, sectors, squares)
    expected = np.array([_kernels.sector_of(x, y, _kernels.SECTORS) for x, y in xy.T])
    apart = np.abs(sectors - expected)
    assert np.all(np.minimum(apart, _kernels.SECTORS - apart) <= 1)
    np.testing.assert_allclose(squares, distance**2, rtol=1e-5)


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_groups_hold_all_points_within_their_circles(seed):
    from mapmend.consistency import _kernels

    rng = np.random.default_rng(seed)
    scans = scans_of(LASERS, [random_readings(rng, g.beam_count) for g in LASERS])
    views = view_scans(scans, CONFIG)
    points = views.points
    np.testing.assert_array_equal(points.group_rows[points.group_offsets], points.offsets)
    sizes = np.diff(points.group_rows)
    assert np.all((sizes >= 1) & (sizes <= _kernels.GROUP))
    away = points.xy - np.repeat(points.groups.T, sizes, axis=0)
    assert np.all(np.hypot(*away.T) <= _kernels.GROUP_RADIUS_M + 1e-5)
