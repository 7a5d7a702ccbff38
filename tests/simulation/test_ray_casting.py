"""Ray casting against its plain twin, and against rooms whose ranges are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import MapmendError
from mapmend.simulation._shapes import box
from mapmend.simulation.ray_casting import cast_rays
from tests.reference import simulation_ray_casting as plain


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 100_000), st.floats(1.0, 20.0))
def test_the_same_as_the_plain_twin(seed, max_range_m):
    rng = np.random.default_rng(seed)
    walls, poses = rng.uniform(-8.0, 8.0, (12, 4)), rng.uniform(-8.0, 8.0, (3, 3))
    bearings = rng.uniform(-np.pi, np.pi, 20)
    fast, slow = (cast(walls, poses, bearings, max_range_m) for cast in (cast_rays, plain.cast_rays))
    np.testing.assert_allclose(fast, slow, rtol=1e-7)


def test_a_room_of_four_by_three_metres():
    quarter = np.pi / 2.0
    ranges = cast_rays(box((0.0, 0.0, 4.0, 3.0)), [[1.0, 1.0, 0.0], [1.0, 1.0, quarter]], [-quarter, 0, quarter], 8.0)
    np.testing.assert_allclose(ranges, [[1.0, 3.0, 2.0], [3.0, 2.0, 1.0]])


@given(st.floats(0.1, 3.9), st.floats(0.1, 2.9), st.floats(-np.pi, np.pi))
def test_in_a_room_every_ray_ends_on_its_wall(x, y, theta):
    bearings = np.linspace(-np.pi, np.pi, 73)
    ranges = cast_rays(box((0.0, 0.0, 4.0, 3.0)), [[x, y, theta]], bearings, 30.0)[0]
    ends = np.column_stack((x + ranges * np.cos(theta + bearings), y + ranges * np.sin(theta + bearings)))
    off_the_wall = np.min(np.abs(np.hstack((ends - [0.0, 0.0], ends - [4.0, 3.0]))), axis=1)
    np.testing.assert_allclose(off_the_wall, 0.0, atol=1e-9)
    assert np.all((ends > -1e-9) & (ends < np.array([4.0, 3.0]) + 1e-9))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000))
def test_no_ray_passes_a_wall(seed):
    """Cut any ray off just short of its range and it touches no wall: on both sides of each wall line, or beside it."""
    rng = np.random.default_rng(seed)
    walls, bearings = rng.uniform(-6.0, 6.0, (15, 4)), np.linspace(-np.pi, np.pi, 60)
    ranges = cast_rays(walls, np.zeros((1, 3)), bearings, 10.0)[0]
    reach = np.where(np.isfinite(ranges), ranges * (1.0 - 1e-6), 10.0)
    tips = reach[:, None] * np.column_stack((np.cos(bearings), np.sin(bearings)))
    begin, end = walls[:, :2], walls[:, 2:]

    def side(a, b, c):
        return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])

    zero, tip = np.zeros(2), tips[:, None, :]
    ray_crosses_line = side(begin, end, zero)[None, :] * side(begin, end, tip) < 0.0
    wall_crosses_ray = side(zero, tip, begin) * side(zero, tip, end) < 0.0
    assert not np.any(ray_crosses_line & wall_crosses_ray)


def test_no_ray_slips_through_where_walls_meet():
    rng = np.random.default_rng(5)
    for _ in range(200):
        corner, a, b = rng.uniform(-5.0, 5.0, (3, 2))
        if np.cross(np.append(a - corner, 0.0), np.append(b - corner, 0.0))[2] == 0.0:
            continue
        towards = np.arctan2(corner[1], corner[0])
        ranges = cast_rays([[*a, *corner], [*corner, *b]], [[0.0, 0.0, 0.0]], [towards], 100.0)
        assert ranges[0, 0] <= np.hypot(*corner) + 1e-6


def test_beyond_the_maximum_nothing_comes_back():
    wall = [[5.0, -1.0, 5.0, 1.0]]
    assert cast_rays(wall, [[0.0, 0.0, 0.0]], [0.0], 5.0)[0, 0] == np.inf
    assert cast_rays(wall, [[0.0, 0.0, 0.0]], [0.0], 5.001)[0, 0] == pytest.approx(5.0)
    assert np.all(np.isinf(cast_rays(np.zeros((0, 4)), [[0.0, 0.0, 0.0]], [0.0], 5.0)))
    assert np.isinf(cast_rays([[1.0, 0.0, 2.0, 0.0]], [[0.0, 0.0, 0.0]], [0.0], 5.0)[0, 0]), "seen end-on"


def test_other_shapes_are_refused():
    with pytest.raises(MapmendError, match=r"walls \(w, 4\)"):
        cast_rays(np.zeros((3, 3)), np.zeros((1, 3)), np.zeros(4), 8.0)
