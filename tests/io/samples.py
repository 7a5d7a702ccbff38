"""Short valid files, and logs and graphs made by hypothesis."""

import numpy as np
from hypothesis import strategies as st

from mapmend.graph.pose_graph import PoseGraph
from mapmend.scan import LaserGeometry, ScanLog, Scans

HALF_TURN = LaserGeometry(181, -np.pi / 2, np.pi / 180, 30.0, (0.22, 0.0, 0.0))


def flaser(ranges="1.00 2.00 3.00", poses="0 0 0 0 0 0", count=None, tail=" 10.5 host 0.5", word="FLASER"):
    return f"{word} {len(ranges.split()) if count is None else count} {ranges} {poses}{tail}"


def robotlaser(ranges="1.00 2.00 3.00", poses="0.1 0 0 0 0 0", header="0 -0.5 1.0 0.5 30.0 0.01 0", stamp="10.5"):
    return f"ROBOTLASER1 {header} {len(ranges.split())} {ranges} 0 {poses} 0 0 0 0 0 {stamp} host 0.5"


def short_log() -> str:
    lines = ["# CARMEN log", "PARAM robot_frontlaser_offset 0.1 nohost 0", "PARAM robot_front_laser_max 80.0 nohost 0"]
    for k in range(5):
        ranges = " ".join(f"{1 + 0.01 * i + 0.1 * k:.2f}" for i in range(8))
        lines.append(f"ODOM {k}.0 0 0 0 0 0 {k}.5 host 0")
        lines.append(flaser(ranges, f"{0.1 + 0.2 * k:.6f} 0 0 {0.2 * k:.6f} 0 0", tail=f" {k}.75 host {k}.75"))
    return "\n".join(lines) + "\n"


def short_graph() -> str:
    lines = []
    for k in range(4):
        lines += [f"VERTEX_SE2 {k} {k}.5 0.25 0.1", robotlaser(poses=f"{k}.6 0.25 0.1 {k}.5 0.25 0.1", stamp=f"{k}.5")]
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        lines.append(f"EDGE_SE2 {i} {j} 1 0 0.1 10 0 0 10 0 40")
    return "\n".join([*lines, "FIX 0"]) + "\n"


def _finite(limit: float):
    return st.floats(-limit, limit, allow_nan=False, allow_subnormal=False)


_poses = st.tuples(_finite(1e4), _finite(1e4), _finite(3.1))


@st.composite
def geometries(draw) -> LaserGeometry:
    if draw(st.booleans()):
        count = draw(st.sampled_from([180, 181, 360, 361]))
        step = np.deg2rad(1.0 if count < 200 else 0.5)
        return LaserGeometry(count, -np.pi / 2, step, draw(st.floats(5.0, 100.0)), (draw(_finite(1.0)), 0.0, 0.0))
    first, step = draw(_finite(3.1)), draw(st.floats(1e-3, 0.1))
    mounting = draw(st.tuples(_finite(1.0), _finite(1.0), _finite(3.1)))
    return LaserGeometry(draw(st.integers(1, 12)), first, step, draw(st.floats(5.0, 100.0)), mounting)


@st.composite
def scans(draw, n: int, may_be_empty: bool = False) -> Scans:
    lasers = tuple(draw(st.lists(geometries(), min_size=1, max_size=2, unique=True)))
    index = np.array([draw(st.integers(0, len(lasers) - 1)) for _ in range(n)], np.int32)
    # The lasers in the order of their first use, and none unused: so a file gives them back.
    used = list(dict.fromkeys(index.tolist()))
    index = np.array([used.index(k) for k in index.tolist()], np.int32)
    lasers = tuple(lasers[k] for k in used)
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    decimals = draw(st.sampled_from([2, 3, None]))
    parts = []
    for k in index:
        laser = lasers[k]
        ranges = random.uniform(0.02, 0.98 * laser.max_range_m, laser.beam_count)
        ranges = np.maximum(ranges if decimals is None else np.round(ranges, decimals), 0.01).astype(np.float32)
        ranges[random.random(laser.beam_count) < 0.1] = np.inf
        ranges[random.random(laser.beam_count) < 0.05] = np.nan
        parts.append(ranges)
    if may_be_empty and n > 1 and draw(st.booleans()):
        parts[-1] = parts[-1][:0]
    offsets = np.concatenate(([0], np.cumsum([len(p) for p in parts]))).astype(np.int64)
    return Scans(np.concatenate(parts), offsets, index, lasers)


@st.composite
def logs(draw) -> ScanLog:
    n = draw(st.integers(1, 5))
    has_stamps = n < 2 or draw(st.booleans())
    stamps = np.arange(n, dtype=np.float64)
    if has_stamps:
        stamps = np.array(draw(st.lists(st.floats(0.0, 2e9), min_size=n, max_size=n, unique=True)))
    odometry = np.array([draw(_poses) for _ in range(n)])
    return ScanLog(draw(scans(n)), stamps, odometry, has_stamps)


@st.composite
def graphs(draw) -> PoseGraph:
    n = draw(st.integers(2, 6))
    ids = np.array(draw(st.lists(st.integers(0, 10**6), min_size=n, max_size=n, unique=True)), np.int64)
    poses = np.array([draw(_poses) for _ in range(n)])
    pairs = [(i, i + 1) for i in range(n - 1)] + draw(
        st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda p: p[0] != p[1]), max_size=4)
    )
    m = len(pairs)
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    roots = random.normal(size=(m, 3, 3))
    information = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)
    information = 0.5 * (information + information.transpose(0, 2, 1))
    is_loop = np.array([draw(st.booleans()) for _ in pairs], np.bool_)
    fixed = tuple(sorted(draw(st.sets(st.integers(0, n - 1), min_size=1, max_size=2))))
    with_scans = draw(st.booleans())
    stamps = random.uniform(1e9, 2e9, n) if draw(st.booleans()) else None
    return PoseGraph(
        poses, ids, np.array(pairs, np.int64), random.normal(size=(m, 3)), information, is_loop,
        draw(scans(n, may_be_empty=True)) if with_scans else None, stamps, fixed,
    )  # fmt: skip


def assert_same_scans(got: Scans, expected: Scans) -> None:
    np.testing.assert_array_equal(got.ranges_m, expected.ranges_m)
    np.testing.assert_array_equal(got.offsets, expected.offsets)
    for k in range(len(expected)):
        if not len(expected.ranges_of(k)):
            continue
        a, b = got.geometry_of(k), expected.geometry_of(k)
        assert (a.beam_count, a.max_range_m) == (b.beam_count, b.max_range_m)
        angles = a.first_angle_rad - b.first_angle_rad, a.angle_increment_rad - b.angle_increment_rad
        np.testing.assert_allclose(angles, 0.0, atol=1e-12)
        step = np.array(a.T_robot_laser) - np.array(b.T_robot_laser)
        step[2] = (step[2] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(step, 0.0, atol=1e-8)
