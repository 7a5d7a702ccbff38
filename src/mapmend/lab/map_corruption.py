"""Maps that are known to be right or wrong, simulated and real: typical errors of mapping, with labels.

A corruption changes the edges of a graph, as a failing front end does, and the optimizer turns it into a wrong map.
Its labels come from comparing the poses with those before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from mapmend.config import ConsistencyConfig
from mapmend.consistency.measure import measure_pairs
from mapmend.consistency.visibility import view_scans
from mapmend.errors import MapmendError
from mapmend.geometry import se2
from mapmend.graph.optimizer import optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.scan import ScanLog
from mapmend.simulation import LaserModel, World, simulate
from mapmend.simulation.dynamics import STATIC, Dynamics, scan_changing_world

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]

NODE_INTERVAL_S = 0.6
"""Of a simulated drive: one node every 0.24 m, or every 0.36 rad of a turn on the spot."""

ODOMETRY_STD = np.array([0.006, 0.006, 0.0015])
LOOP_STD = np.array([0.01, 0.01, 0.003])
"""Standard deviations of simulated edges, m, m, rad: typical errors of scan matching."""

LOOP_REACH_M, LOOP_EVERY, LOOP_AFTER = 1.5, 3, 40
"""Every n-th node gets a loop edge to the nearest node within reach that was left at least this many nodes ago."""

TOUCHED_M, LEVER_M = 0.08, 3.0
"""A pair of scans is wrong if its relative pose is off by this; the angle counts with a lever of LEVER_M."""

COMMON_POINTS = 10
"""Scans overlap if they have at least this many inconsistent points; even right maps have half as many."""

FEWEST_TOUCHED = 12
"""A corruption that touches fewer scans could not be seen by anybody: it is drawn again."""

MOST_DRAWS = 40


@dataclass(frozen=True)
class LabelledMap:
    """A map and the truth about it. ``kind``: "consistent", or the kind of corruption.

    ``touched``: bool, (n,), scans that overlap with a scan to which their relative pose is wrong. ``region``: (n,), the
    number of the connected region of such pairs, -1 elsewhere. ``false_edges``: rows of ``graph.edges``.
    """

    kind: str
    graph: PoseGraph
    touched: Bool
    region: Int
    false_edges: Int

    @property
    def consistent(self) -> bool:
        return self.kind == "consistent"


def simulated_map(
    world: World, seed: int, *, dynamics: Dynamics = STATIC, laser: LaserModel | None = None, noise: float = 1.0
) -> PoseGraph:
    """A map as SLAM makes it: scans from true poses, noisy edges, and the optimum of these. Node 0 is at the truth.

    ``noise`` is a factor on the edges' standard deviations. The same arguments give the same bytes.
    """
    laser = laser or LaserModel()
    drive = simulate(world, laser, seed=seed, scan_interval_s=NODE_INTERVAL_S)
    truth, stamps = drive.truth, drive.log.stamps_s
    scans = scan_changing_world(world, laser, truth, stamps, seed, dynamics=dynamics)
    n = len(truth)
    steps = np.stack((np.arange(n - 1), np.arange(1, n)), axis=1)
    loops = _true_loops(truth)
    edges = np.concatenate((steps, loops))
    std = noise * np.concatenate((np.tile(ODOMETRY_STD, (len(steps), 1)), np.tile(LOOP_STD, (len(loops), 1))))
    errors = std * default_rng([seed, 1]).standard_normal(std.shape)
    graph = PoseGraph(
        poses=truth,
        ids=np.arange(n),
        edges=edges,
        measurements=se2.compose(se2.between(truth[edges[:, 0]], truth[edges[:, 1]]), errors),
        information=np.eye(3) / std[:, None, :] ** 2,
        is_loop=np.arange(len(edges)) >= len(steps),
        scans=scans,
        stamps_s=stamps,
    )
    return graph.with_poses(optimize(graph).poses)


def graph_of_log(log: ScanLog) -> PoseGraph:
    """The poses of a log as they are, with edges computed from them: a map of key scans that were matched."""
    n = len(log)
    edges = np.stack((np.arange(n - 1), np.arange(1, n)), axis=1)
    return PoseGraph(
        poses=log.odometry,
        ids=np.arange(n),
        edges=edges,
        measurements=se2.between(log.odometry[:-1], log.odometry[1:]),
        information=np.tile(np.diag(1.0 / LOOP_STD**2), (n - 1, 1, 1)),
        is_loop=np.zeros(n - 1, np.bool_),
        scans=log.scans,
    )


def consistent_map(graph: PoseGraph) -> LabelledMap:
    """The graph as a map that is assumed to be right."""
    n = len(graph)
    return LabelledMap("consistent", graph, np.zeros(n, np.bool_), np.full(n, -1), np.zeros(0, np.int64))


def corrupt(graph: PoseGraph, kind: str, seed: int) -> LabelledMap:
    """A right map made wrong in one of the ways of `CORRUPTIONS`, with labels.

    Raises MapmendError if no place of the map allows it, because nothing is seen twice.
    """
    if kind not in CORRUPTIONS:
        raise MapmendError(f"there is no corruption '{kind}'; use one of {', '.join(CORRUPTIONS)}")
    rng = default_rng([seed, *kind.encode()])
    for draw in range(MOST_DRAWS):
        broken, false_edges = CORRUPTIONS[kind](graph, rng, 1 + draw // 8)
        made = optimize(broken)
        wrong = broken.with_poses(made.poses)
        touched, region = label(graph, wrong)
        if np.count_nonzero(touched) >= FEWEST_TOUCHED:
            return LabelledMap(kind, wrong, touched, region, false_edges)
    raise MapmendError(f"no '{kind}' shows in this map of {len(graph)} scans after {MOST_DRAWS} draws")


def label(right: PoseGraph, wrong: PoseGraph) -> tuple[Bool, Int]:
    """Which scans a corruption touched, (n,), and in which connected region of wrong pairs each lies, (n,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    config = ConsistencyConfig()
    assert right.scans is not None
    views = view_scans(right.scans, config)
    pairs = np.concatenate([measure_pairs(views.placed(g.poses), COMMON_POINTS).pairs for g in (right, wrong)])
    before, after = (se2.between(g.poses[pairs[:, 0]], g.poses[pairs[:, 1]]) for g in (right, wrong))
    off = se2.between(before, after)
    is_wrong = np.hypot(off[:, 0], off[:, 1]) + LEVER_M * np.abs(off[:, 2]) > TOUCHED_M
    a, b = pairs[is_wrong].T
    n = len(right)
    touched = np.zeros(n, np.bool_)
    touched[a] = touched[b] = True
    _, number = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)
    return touched, np.where(touched, number, -1).astype(np.int64)


def _false_loop(graph: PoseGraph, rng: Generator, strength: int) -> tuple[PoseGraph, Int]:
    """Two places some metres apart are merged by the edges of ``strength`` consecutive nodes."""
    i, j = _two_places(graph, rng, (3.0, 15.0))
    steps = np.arange(strength)
    first, second = np.minimum(i + steps, len(graph) - 1), np.minimum(j + steps, len(graph) - 1)
    claimed = np.concatenate((rng.normal(0.0, 0.2, 2), rng.normal(0.0, 0.05, 1)))
    return _with_loops(graph, np.stack((first, second), axis=1)[: len(np.unique(second))], claimed)


def _merged_rooms(graph: PoseGraph, rng: Generator, strength: int) -> tuple[PoseGraph, Int]:
    """A stretch of nodes is laid on another place, and the edges to its own place are missing."""
    i, j = _two_places(graph, rng, (2.5, 10.0))
    stretch = np.arange(max(j - 15, 0), min(j + 15, len(graph)))
    tied = np.isin(graph.edges, stretch).any(axis=1) & graph.is_loop
    steps = np.arange(0, 3 * strength, 2)
    ends = np.stack((np.minimum(i + steps, len(graph) - 1), np.minimum(j + steps, len(graph) - 1)), axis=1)
    return _with_loops(graph.with_edges(~tied), ends[ends[:, 0] != ends[:, 1]], np.zeros(3))


def _missing_loop(graph: PoseGraph, rng: Generator, strength: int) -> tuple[PoseGraph, Int]:
    """The drift of some nodes adds up, and no loop corrects it."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    length = rng.uniform(0.3, 0.8) * strength
    error = (
        length * np.cos(angle),
        length * np.sin(angle),
        rng.choice((-1.0, 1.0)) * np.radians(rng.uniform(1.0, 3.0)),
    )
    return _slipped(graph, rng, np.array(error), 30)


def _bent_corridor(graph: PoseGraph, rng: Generator, strength: int) -> tuple[PoseGraph, Int]:
    """The heading drifts over some metres."""
    bend = rng.choice((-1.0, 1.0)) * np.radians(rng.uniform(4.0, 10.0)) * strength
    return _slipped(graph, rng, np.array([0.0, 0.0, bend]), int(rng.integers(10, 25)))


def _double_wall(graph: PoseGraph, rng: Generator, strength: int) -> tuple[PoseGraph, Int]:
    """All later nodes are shifted by 10 to 50 cm."""
    angle, length = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.5) * strength
    return _slipped(graph, rng, np.array([length * np.cos(angle), length * np.sin(angle), 0.0]), 6)


def _rotated_wing(graph: PoseGraph, rng: Generator, strength: int) -> tuple[PoseGraph, Int]:
    """One step turns all later nodes."""
    turn = rng.choice((-1.0, 1.0)) * np.radians(rng.uniform(3.0, 10.0)) * strength
    return _slipped(graph, rng, np.array([0.0, 0.0, turn]), 1)


CORRUPTIONS: dict[str, Callable[[PoseGraph, Generator, int], tuple[PoseGraph, Int]]] = {
    "false loop": _false_loop,
    "missing loop": _missing_loop,
    "bent corridor": _bent_corridor,
    "double wall": _double_wall,
    "rotated wing": _rotated_wing,
    "merged rooms": _merged_rooms,
}
"""A corruption: from a graph, random numbers and a strength, from 1 on, to a graph and the rows of its false edges."""


def _two_places(graph: PoseGraph, rng: Generator, apart_m: tuple[float, float]) -> tuple[int, int]:
    """Two nodes at the given distances, in the map and along the trajectory."""
    n = len(graph)
    for _ in range(1000):
        i, j = sorted(rng.integers(0, n, 2).tolist())
        if (
            j - i > min(LOOP_AFTER, n // 4)
            and apart_m[0] < np.hypot(*(graph.poses[i] - graph.poses[j])[:2]) < apart_m[1]
        ):
            return i, j
    raise MapmendError(f"no two nodes lie {apart_m[0]:g} m to {apart_m[1]:g} m apart")


def _slipped(graph: PoseGraph, rng: Generator, error: Float, steps: int) -> tuple[PoseGraph, Int]:
    """The odometry errs by ``error`` in total over some steps, and no loop edge joins later nodes to earlier ones.

    ``error``: the motion of all later nodes, in the map's axes about the first of them.
    """
    n = len(graph)
    first = int(rng.integers(n // 5, 4 * n // 5))
    last = min(first + steps, n - 1)
    share = np.clip((np.arange(n) - first + 1) / max(last - first + 1, 1), 0.0, 1.0)
    pivot = graph.poses[first, :2]
    turn, moved = share * error[2], graph.poses.copy()
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = (graph.poses[:, :2] - pivot).T
    moved[:, 0] = pivot[0] + cos * x - sin * y + share * error[0]
    moved[:, 1] = pivot[1] + sin * x + cos * y + share * error[1]
    moved[:, 2] = se2.wrap_angle(graph.poses[:, 2] + turn)
    earlier = graph.edges < last
    kept = graph.with_edges(~(graph.is_loop & (earlier[:, 0] != earlier[:, 1])))
    slips = ~kept.is_loop & ((kept.edges >= first - 1) & (kept.edges <= last)).all(axis=1)
    measurements = kept.measurements.copy()
    i, j = kept.edges[slips].T
    # Each slipping step keeps its own noise in addition to the new motion.
    noise = se2.between(se2.between(graph.poses[i], graph.poses[j]), measurements[slips])
    measurements[slips] = se2.compose(se2.between(moved[i], moved[j]), noise)
    return replace(kept, poses=moved, measurements=measurements), np.zeros(0, np.int64)


def _with_loops(graph: PoseGraph, ends: Int, claimed: Float) -> tuple[PoseGraph, Int]:
    """The graph with false loop edges that measure ``claimed`` between their nodes, and the rows of these edges."""
    m, k = len(graph.edges), len(ends)
    like = graph.information[graph.is_loop] if graph.is_loop.any() else graph.information
    broken = replace(
        graph,
        edges=np.concatenate((graph.edges, ends)),
        measurements=np.concatenate((graph.measurements, np.tile(claimed, (k, 1)))),
        information=np.concatenate((graph.information, np.tile(np.median(like, axis=0), (k, 1, 1)))),
        is_loop=np.concatenate((graph.is_loop, np.ones(k, np.bool_))),
    )
    return broken, np.arange(m, m + k)


def _true_loops(truth: Float) -> Int:
    """Pairs (i, j), i < j: the nearest node of an earlier visit, for every n-th node."""
    found = []
    for j in range(LOOP_AFTER + 1, len(truth), LOOP_EVERY):
        earlier = truth[: j - LOOP_AFTER]
        away = np.hypot(*(earlier[:, :2] - truth[j, :2]).T) + np.abs(se2.wrap_angle(earlier[:, 2] - truth[j, 2]))
        i = int(np.argmin(away))
        if away[i] < LOOP_REACH_M:
            found.append((i, j))
    return np.array(found, dtype=np.int64).reshape(-1, 2)
