"""The whole check on one page: from a pose graph with scans to a verdict, and to the places where the map is wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config, ConsistencyConfig, require_config
from mapmend.consistency.cascade import PairTests, ScanTests, judge_pairs, judge_scans, map_p_value
from mapmend.consistency.measure import measure_pairs
from mapmend.consistency.regions import InconsistentRegion, contradicting_points, find_regions
from mapmend.consistency.scale import OdometryMap, estimate_scales, odometry_map, pair_scales, sensor_scales
from mapmend.consistency.suspects import suspect_loops
from mapmend.consistency.views import PlacedViews, ScanViews
from mapmend.consistency.visibility import view_scans
from mapmend.errors import MapmendError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.parallel import Progress, no_progress

Float = NDArray[np.float64]

DEFAULT_CONFIG = Config()


@dataclass(frozen=True)
class Basis:
    """The part of a check that does not depend on the poses of the nodes.

    ``views``: what the scans saw. ``laid``: the odometry edges laid end to end. ``scales_m``: (n,), each node's.
    ``notes``: what had to be assumed.
    """

    views: ScanViews
    laid: OdometryMap
    scales_m: Float
    notes: tuple[str, ...]


@dataclass(frozen=True)
class CheckResult:
    """What the check found. ``p_value``: of the map; ``consistent``: whether it is above the level.

    ``scales_m``: (n,), each node's. ``points``: bool, the end points of ``views`` that contradict other scans.
    ``suspects``: rows of the graph's loop edges, the most suspect first, and ``against``, the evidence against each.
    ``regions``: where the map is wrong, the worst first. ``notes``: what had to be assumed.
    """

    consistent: bool
    p_value: float
    views: PlacedViews
    scales_m: Float
    overlapping: int
    pairs: PairTests
    scans: ScanTests
    points: NDArray[np.bool_]
    suspects: NDArray[np.int64]
    against: Float
    regions: list[InconsistentRegion]
    notes: tuple[str, ...]


def check(
    graph: PoseGraph,
    config: Config = DEFAULT_CONFIG,
    *,
    threads: int = 1,
    progress: Progress = no_progress,
) -> CheckResult:
    """Whether the graph's map is consistent; the same for any number of threads.

    Of ``config``, the block ``consistency`` counts. Raises MapmendError for a graph with fewer than two scans, or
    without scans that see a common area.
    """
    require_config(config)
    settings = config.consistency
    basis = basis_of(graph, settings, threads=threads, progress=progress)
    return judge_map(graph, basis, settings, threads=threads, progress=progress)


def basis_of(
    graph: PoseGraph, config: ConsistencyConfig, *, threads: int = 1, progress: Progress = no_progress
) -> Basis:
    """The basis for judging maps of the graph at any poses; raises MapmendError as `check` does."""
    scans = graph.scans
    with_scans = 0 if scans is None else int(np.count_nonzero(np.diff(scans.offsets)))
    if scans is None or with_scans < 2:
        what = f"{with_scans} of {len(graph)} nodes carry a scan; a check compares at least two"
        raise MapmendError(f"{what}: name a graph whose nodes carry their scans")
    notes = []
    if with_scans < len(graph):
        notes.append(f"{len(graph) - with_scans} of {len(graph)} nodes carry no scan and are left out")
    views, laid = view_scans(scans, config), odometry_map(graph)
    scales = estimate_scales(views, laid, config, threads, progress)
    if scales is None:
        notes.append("no scale can be estimated without odometry edges between scans; the laser's own noise is used")
        scales = sensor_scales(len(graph), config)
    return Basis(views, laid, scales, tuple(notes))


def judge_map(
    graph: PoseGraph, basis: Basis, config: ConsistencyConfig, *, threads: int = 1, progress: Progress = no_progress
) -> CheckResult:
    """The verdict on the map with the graph's nodes at ``graph.poses``, MC section IV."""
    notes, scales = list(basis.notes), basis.scales_m
    views = basis.views.placed(graph.poses)
    drop = (config.drop_points, config.drop_share)
    measures = measure_pairs(views, config.min_points, drop, threads, progress)
    pairs = judge_pairs(measures, scales, config, basis.laid)
    if not len(pairs.pairs):
        notes.append("no two scans see enough in common to contradict each other: nothing was tested")
    tests = judge_scans(pairs, len(graph), config)
    p_value = map_p_value(tests, config)
    points = contradicting_points(views, pairs, tests, pairs.inflation * pair_scales(scales, pairs.pairs, config))
    suspects, against = suspect_loops(
        graph, basis.views, basis.laid, pairs.inflation * scales, config, threads=threads, progress=progress
    )
    return CheckResult(
        consistent=p_value > config.map_level,
        p_value=p_value,
        views=views,
        scales_m=scales,
        overlapping=measures.overlapping,
        pairs=pairs,
        scans=tests,
        points=points,
        suspects=suspects,
        against=against,
        regions=find_regions(graph, views, pairs, tests, points=points, suspects=suspects),
        notes=tuple(notes),
    )
