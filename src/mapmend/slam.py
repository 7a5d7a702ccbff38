"""The whole method on one page: from a log to a trajectory, a pose graph with scans, and a map.

read   io.read_log           a log of scans, with the odometry at each
match  front_end.builder     IGO III: predict, match, open nodes and key-nodes, search loops, optimize (IGO's "GO")
mend   igo.iterate           IGO IV: match edges again from the optimizer's poses, until chi2 settles
tune   tuning.tune           if wanted: choose by the scans from which chi2 on loops are doubted (MC V)
map    grid.occupancy        the nodes' scans at the optimized poses
write  run_folder            trajectory, graph, map, and a picture of them
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmend.config import Config, require_config
from mapmend.errors import InputError, MapmendError
from mapmend.geometry import se2
from mapmend.graph.pose_graph import PoseGraph
from mapmend.grid.alignment import Alignment, align_walls
from mapmend.grid.occupancy import occupancy_map
from mapmend.maps import OccupancyMap
from mapmend.parallel import Progress, no_progress
from mapmend.scan import ScanLog
from mapmend.trajectory import Trajectory

if TYPE_CHECKING:
    from mapmend.front_end.builder import FrontEnd
    from mapmend.igo.iterate import Iteration
    from mapmend.tuning.tune import TuneResult

Float = NDArray[np.float64]
Int = NDArray[np.int64]

DEFAULT_METHOD = "igo"
DEFAULT_CONFIG = Config()


@dataclass(frozen=True)
class MapResult:
    """The result of a method. All poses are ``T_map_robot``; the map's frame is the robot's at the first scan, turned
    by ``alignment.T_map_start`` if the configuration wants straight maps.

    ``trajectory``: a pose for every scan, in the log's order. ``graph``: the nodes with their scans and stamps.
    ``key_nodes``: rows of the graph's nodes that open a key-node. ``chi2_initial`` is that of the odometry edges laid
    end to end, ``chi2_final`` that of the graph's poses. ``mended``: the rounds of ``igo``,
    None for other methods. ``tuning``: None unless the configuration wants it. ``seconds``: by stage.
    """

    method: str
    config: Config
    trajectory: Trajectory
    graph: PoseGraph
    occupancy: OccupancyMap
    key_nodes: Int
    counts: dict[str, int]
    chi2_initial: float
    chi2_final: float
    seconds: dict[str, float]
    alignment: Alignment | None = None
    mended: Iteration | None = None
    tuning: TuneResult | None = None


@dataclass(frozen=True)
class RebuildResult:
    """``graph``: the same nodes in the same order, at the optimum, with the edges matched again: odometry, further
    odometry, loops. ``iteration``: what each round did.
    """

    graph: PoseGraph
    iteration: Iteration


@dataclass(frozen=True)
class Built:
    """The input of the map: a graph with scans, ``scan_poses`` (n, 3) for all scans, and what the method did.

    ``scans_at``: gives the poses of all scans for other poses of the nodes, (nodes, 3); None if the method has no nodes
    that could move.
    """

    graph: PoseGraph
    scan_poses: Float
    key_nodes: Int
    searched: int = 0
    optimizations: int = 0
    mended: Iteration | None = None
    scans_at: Callable[[Float], Float] | None = None


def build_map(
    log: ScanLog,
    method: str = DEFAULT_METHOD,
    config: Config = DEFAULT_CONFIG,
    *,
    threads: int = 1,
    progress: Progress = no_progress,
) -> MapResult:
    """Maps a log by one of `METHODS`; the same log, configuration and seed give the same result for any ``threads``.

    A log without odometry is mapped from the laser alone, and ``MapResult.config`` says so. Raises MapmendError for an
    unknown method, and for a log without motion, scans or returns.
    """
    require_config(config)
    if not log.has_odometry:
        config = config.with_settings({"motion.use_odometry": False})
    check_method(method, config)
    check_log(log, config)
    log = replace(log, odometry=se2.to_the_nanometre(log.odometry))
    seconds: dict[str, float] = {}
    with stage("match", seconds):
        built = METHODS[method](log, config, progress, threads)
    tuning = None
    if config.loops.tune:
        with stage("tune", seconds):
            built, tuning = tuned(built, config, threads, progress)
    with stage("map", seconds):
        built, alignment = aligned(built, config)
        graph = built.graph
        assert graph.scans is not None
        occupancy = occupancy_map(
            graph.scans, graph.poses, config.scan, config.grid, threads=threads, progress=progress
        )
    chi2_initial, chi2_final = _chi2(graph)
    return MapResult(
        method=method,
        config=config,
        trajectory=Trajectory(log.stamps_s, built.scan_poses),
        graph=graph,
        occupancy=occupancy,
        key_nodes=built.key_nodes,
        counts=_counts(log, built),
        chi2_initial=chi2_initial,
        chi2_final=chi2_final,
        seconds=seconds,
        alignment=alignment,
        mended=built.mended,
        tuning=tuning,
    )


def iterative_graph_optimization(
    log: ScanLog, config: Config, progress: Progress = no_progress, threads: int = 1
) -> Built:
    """``igo``: the graph of ``go``, mended. IGO section IV, Algorithm 1."""
    from mapmend.front_end.builder import FrontEnd
    from mapmend.igo.iterate import iterate

    front_end = FrontEnd(log.scans.geometries, config, progress)
    iteration = iterate(front_end.run(log), progress)
    return replace(_built(front_end), mended=iteration)


def graph_optimization(log: ScanLog, config: Config, progress: Progress = no_progress, threads: int = 1) -> Built:
    """``go``: the front end with its loops, optimized whenever one closes. IGO section III."""
    from mapmend.front_end.builder import FrontEnd

    front_end = FrontEnd(log.scans.geometries, config, progress)
    front_end.run(log)
    return _built(front_end)


def rebuild(graph: PoseGraph, config: Config = DEFAULT_CONFIG, *, progress: Progress = no_progress) -> RebuildResult:
    """Optimizes a pose graph of any system with scans on its nodes, and matches its edges again: IGO IV.

    Consecutive nodes are those whose ids follow each other (`ScanGraph.from_pose_graph`). Edges that are matched again
    keep their information. Raises MapmendError for a graph without scans, or one that can't be optimized.
    """
    from mapmend.graph.checks import check_connections, check_numbers
    from mapmend.igo.iterate import iterate
    from mapmend.scan_graph.scan_graph import ScanGraph

    require_config(config)
    check_numbers(graph)
    check_connections(graph)
    order = np.argsort(graph.ids, kind="stable")
    ordered = graph.with_order(order)
    scan_graph = ScanGraph.from_pose_graph(ordered, config)
    iteration = iterate(scan_graph, progress)
    rebuilt = scan_graph.pose_graph()
    kept = replace(rebuilt, ids=ordered.ids, scans=ordered.scans, stamps_s=ordered.stamps_s, fixed=ordered.fixed)
    return RebuildResult(kept.with_order(np.argsort(order)), iteration)


def _built(front_end: FrontEnd) -> Built:
    graph = front_end.graph
    key_nodes = graph.key_nodes.firsts().copy()
    searched, optimizations = front_end.searched, front_end.optimizations
    pose_graph = graph.pose_graph(with_scans=True)
    return Built(pose_graph, graph.scan_poses(), key_nodes, searched, optimizations, scans_at=graph.hung.scan_poses)


def scan_matching(log: ScanLog, config: Config, progress: Progress = no_progress, threads: int = 1) -> Built:
    """``scanmatch``: laser odometry alone, which is the same front end without loops."""
    return graph_optimization(log, config.with_settings({"loops.enabled": False}), progress, threads)


def odometry_alone(log: ScanLog, config: Config, progress: Progress = no_progress, threads: int = 1) -> Built:
    """``odometry``: the poses of the log, relative to the first one, and a graph of them."""
    from mapmend.scan_graph.chains import OdometryEdge
    from mapmend.scan_graph.motion import odometry_covariance
    from mapmend.scan_graph.scan_graph import ScanGraph

    graph = ScanGraph(config, log.scans.geometries)
    chains, settings = graph.chains, config.key_nodes
    poses = se2.between(log.odometry[0], log.odometry)
    for k, pose in enumerate(poses):
        motion = se2.between(chains.poses[-1], pose) if k else np.zeros(3)
        far = math.hypot(motion[0], motion[1]) >= settings.node_every_m or abs(motion[2]) >= settings.node_every_rad
        if k == 0 or far:
            covariance = odometry_covariance(motion, config.motion)
            edge = OdometryEdge(motion, covariance, covariance) if k else None
            graph.add_node(log.scans.ranges_of(k), log.scans.laser_of(k), pose, edge)
            motion = np.zeros(3)
        graph.hung.hang(float(log.stamps_s[k]), log.odometry[k], chains.last, motion)
    progress("match", len(log), len(log))
    return Built(graph.pose_graph(with_scans=True), poses, np.zeros(0, dtype=np.int64))


def aligned(built: Built, config: Config) -> tuple[Built, Alignment | None]:
    """The same with its walls along the map's axes, and the turn, if the configuration wants it."""
    graph = built.graph
    if not config.grid.align or graph.scans is None:
        return built, None
    alignment = align_walls(graph.scans, graph.poses, config.scan)
    turn = np.array(alignment.T_map_start)
    straight = graph.with_poses(se2.compose(turn, graph.poses))
    return replace(built, graph=straight, scan_poses=se2.compose(turn, built.scan_poses)), alignment


def particle_filter(log: ScanLog, config: Config, progress: Progress = no_progress, threads: int = 1) -> Built:
    """``gmapping``: a Rao-Blackwellized particle filter, Grisetti et al. (2007), which IGO compares with."""
    from mapmend.baselines.gmapping import ParticleFilter, path_graph

    particles = ParticleFilter(log, config, threads, progress)
    particles.run()
    graph, scan_poses = path_graph(particles)
    return Built(graph, scan_poses, np.zeros(0, dtype=np.int64))


METHODS: dict[str, Callable[[ScanLog, Config, Progress, int], Built]] = {
    "igo": iterative_graph_optimization,
    "go": graph_optimization,
    "scanmatch": scan_matching,
    "odometry": odometry_alone,
    "gmapping": particle_filter,
}


def tuned(built: Built, config: Config, threads: int, progress: Progress) -> tuple[Built, TuneResult | None]:
    """The nodes at their poses in the most consistent map, MC section V; unchanged if there is no loop to doubt.

    Every solution starts at the front end's optimum, where the widest kernel leaves the map as it is, so that tuning
    cannot lose a loop that the front end has closed.
    """
    from mapmend.tuning.tune import tune

    if built.scans_at is None or not built.graph.is_loop.any():
        return built, None
    result = tune(built.graph, config, init="given", threads=threads, progress=progress)
    poses = result.graph.poses
    return replace(built, graph=result.graph, scan_poses=built.scans_at(poses)), result


def check_method(method: str, config: Config) -> None:
    """Raises MapmendError for an unknown method, or for one that needs what the configuration switches off."""
    if method not in METHODS:
        raise MapmendError(f"there is no method '{method}'; use one of {', '.join(METHODS)}")
    if method == "odometry" and not config.motion.use_odometry:
        raise MapmendError("method 'odometry' needs odometry; use igo, go or scanmatch")


def check_log(log: ScanLog, config: Config) -> None:
    """Raises InputError that names the log if no map can be made from it."""
    source = log.source or None
    if len(log) < 2:
        raise InputError(source, f"holds {len(log)} scan{'s' * (len(log) != 1)}", "a map takes at least two")
    nearest, farthest = config.scan.min_range_m, config.scan.max_range_m
    if not any(bool(np.any((ranges >= nearest) & (ranges <= farthest))) for ranges in log.scans.blocks()):
        what = f"no scan has a return between {nearest:g} m and {farthest:g} m"
        raise InputError(source, what, "name a log with returns in this range, or set scan.max_range_m")
    if config.motion.use_odometry and not log.odometry_moves:
        raise InputError(source, "the odometry never moves", "run with --no-odometry to map from the laser alone")


@contextmanager
def stage(name: str, seconds: dict[str, float]) -> Iterator[None]:
    """Stores under ``name`` how long the block took."""
    began = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - began


def _counts(log: ScanLog, built: Built) -> dict[str, int]:
    loops, odometry = int(np.count_nonzero(built.graph.is_loop)), len(built.graph) - 1
    return {
        "scans": len(log),
        "nodes": len(built.graph),
        "key_nodes": len(built.key_nodes),
        "odometry_edges": odometry,
        "stretch_edges": len(built.graph.edges) - odometry - loops,
        "loop_edges": loops,
        "scans_searched": built.searched,
        "optimizations": built.optimizations,
    }


def _chi2(graph: PoseGraph) -> tuple[float, float]:
    """chi2 of the odometry edges laid end to end from the first node, and of the graph's own poses."""
    from mapmend.graph.optimizer import edge_chi2

    laid = graph.poses.copy()
    for j, step in enumerate(graph.measurements[: len(graph) - 1], 1):
        laid[j] = se2.compose(laid[j - 1], step)
    return float(edge_chi2(graph.with_poses(laid)).sum()), float(edge_chi2(graph).sum())
