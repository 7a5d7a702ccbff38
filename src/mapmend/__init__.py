"""mapmend: 2D laser SLAM that mends its own graph and checks whether the map can be trusted.

    log = mapmend.read_log("intel.clf.bz2")
    result = mapmend.build_map(log)
    mapmend.write_run(result, "intel-run")

The names in ``__all__`` are the Python interface: docs/python.md. Other modules may change in any version. Names are
loaded when they are first used, so that importing mapmend takes no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mapmend.version import VERSION

if TYPE_CHECKING:
    from mapmend.config import Config as Config
    from mapmend.config import read_toml as read_toml
    from mapmend.consistency.check import CheckResult as CheckResult
    from mapmend.consistency.check import check as check
    from mapmend.datasets.cache import named_file as named_file
    from mapmend.errors import InputError as InputError
    from mapmend.errors import MapmendError as MapmendError
    from mapmend.errors import OutputError as OutputError
    from mapmend.evaluation.relations import relation_errors as relation_errors
    from mapmend.evaluation.trajectory import relative_errors as relative_errors
    from mapmend.evaluation.trajectory import trajectory_errors as trajectory_errors
    from mapmend.front_end.builder import FrontEnd as FrontEnd
    from mapmend.graph.best_start import StartedResult as StartedResult
    from mapmend.graph.best_start import optimize_from as optimize_from
    from mapmend.graph.marginals import marginals as marginals
    from mapmend.graph.optimizer import OptimizationResult as OptimizationResult
    from mapmend.graph.optimizer import optimize as optimize
    from mapmend.graph.pose_graph import PoseGraph as PoseGraph
    from mapmend.graph.robust import Cauchy as Cauchy
    from mapmend.graph.robust import DynamicCovarianceScaling as DynamicCovarianceScaling
    from mapmend.graph.robust import GemanMcClure as GemanMcClure
    from mapmend.graph.robust import GraduatedNonConvexity as GraduatedNonConvexity
    from mapmend.graph.robust import Huber as Huber
    from mapmend.graph.robust import Kernel as Kernel
    from mapmend.graph.robust import MaxMixture as MaxMixture
    from mapmend.graph.robust import Switchable as Switchable
    from mapmend.graph.robust import distrusted as distrusted
    from mapmend.graph.robust import kernel_of as kernel_of
    from mapmend.igo.iterate import Iteration as Iteration
    from mapmend.io.bags.options import BagOptions as BagOptions
    from mapmend.io.graph_text import write_graph as write_graph
    from mapmend.io.read_graph import read_graph as read_graph
    from mapmend.io.read_graph import read_trajectory as read_trajectory
    from mapmend.io.read_log import read_log as read_log
    from mapmend.io.reader import read as read
    from mapmend.maps import OccupancyMap as OccupancyMap
    from mapmend.run_folder import write_run as write_run
    from mapmend.scan import LaserGeometry as LaserGeometry
    from mapmend.scan import ScanLog as ScanLog
    from mapmend.scan import Scans as Scans
    from mapmend.scan_graph.match import ScanMatch as ScanMatch
    from mapmend.scan_graph.match import grid_of as grid_of
    from mapmend.scan_graph.match import match as match
    from mapmend.scan_graph.scan_graph import ScanGraph as ScanGraph
    from mapmend.simulation import LaserModel as LaserModel
    from mapmend.simulation import OdometryModel as OdometryModel
    from mapmend.simulation import Simulation as Simulation
    from mapmend.simulation import SlipEvent as SlipEvent
    from mapmend.simulation import World as World
    from mapmend.simulation import corridor_loop as corridor_loop
    from mapmend.simulation import office_floor as office_floor
    from mapmend.simulation import random_building as random_building
    from mapmend.simulation import simulate as simulate
    from mapmend.slam import MapResult as MapResult
    from mapmend.slam import RebuildResult as RebuildResult
    from mapmend.slam import build_map as build_map
    from mapmend.slam import rebuild as rebuild
    from mapmend.trajectory import Trajectory as Trajectory
    from mapmend.tuning.tune import TuneResult as TuneResult
    from mapmend.tuning.tune import tune as tune

__version__ = VERSION

_HOMES = {
    "BagOptions": "mapmend.io.bags.options",
    "Cauchy": "mapmend.graph.robust",
    "CheckResult": "mapmend.consistency.check",
    "Config": "mapmend.config",
    "DynamicCovarianceScaling": "mapmend.graph.robust",
    "FrontEnd": "mapmend.front_end.builder",
    "GemanMcClure": "mapmend.graph.robust",
    "GraduatedNonConvexity": "mapmend.graph.robust",
    "Huber": "mapmend.graph.robust",
    "InputError": "mapmend.errors",
    "Iteration": "mapmend.igo.iterate",
    "Kernel": "mapmend.graph.robust",
    "LaserGeometry": "mapmend.scan",
    "LaserModel": "mapmend.simulation",
    "MapResult": "mapmend.slam",
    "MapmendError": "mapmend.errors",
    "MaxMixture": "mapmend.graph.robust",
    "OccupancyMap": "mapmend.maps",
    "OdometryModel": "mapmend.simulation",
    "OptimizationResult": "mapmend.graph.optimizer",
    "OutputError": "mapmend.errors",
    "PoseGraph": "mapmend.graph.pose_graph",
    "ScanGraph": "mapmend.scan_graph.scan_graph",
    "ScanLog": "mapmend.scan",
    "ScanMatch": "mapmend.scan_graph.match",
    "RebuildResult": "mapmend.slam",
    "Scans": "mapmend.scan",
    "Simulation": "mapmend.simulation",
    "SlipEvent": "mapmend.simulation",
    "StartedResult": "mapmend.graph.best_start",
    "Switchable": "mapmend.graph.robust",
    "Trajectory": "mapmend.trajectory",
    "TuneResult": "mapmend.tuning.tune",
    "World": "mapmend.simulation",
    "build_map": "mapmend.slam",
    "check": "mapmend.consistency.check",
    "corridor_loop": "mapmend.simulation",
    "distrusted": "mapmend.graph.robust",
    "grid_of": "mapmend.scan_graph.match",
    "kernel_of": "mapmend.graph.robust",
    "marginals": "mapmend.graph.marginals",
    "match": "mapmend.scan_graph.match",
    "named_file": "mapmend.datasets.cache",
    "office_floor": "mapmend.simulation",
    "optimize": "mapmend.graph.optimizer",
    "optimize_from": "mapmend.graph.best_start",
    "random_building": "mapmend.simulation",
    "read": "mapmend.io.reader",
    "read_graph": "mapmend.io.read_graph",
    "read_log": "mapmend.io.read_log",
    "read_toml": "mapmend.config",
    "read_trajectory": "mapmend.io.read_graph",
    "rebuild": "mapmend.slam",
    "relation_errors": "mapmend.evaluation.relations",
    "relative_errors": "mapmend.evaluation.trajectory",
    "simulate": "mapmend.simulation",
    "trajectory_errors": "mapmend.evaluation.trajectory",
    "tune": "mapmend.tuning.tune",
    "write_graph": "mapmend.io.graph_text",
    "write_run": "mapmend.run_folder",
}

__all__ = [
    "BagOptions",
    "Cauchy",
    "CheckResult",
    "Config",
    "DynamicCovarianceScaling",
    "FrontEnd",
    "GemanMcClure",
    "GraduatedNonConvexity",
    "Huber",
    "InputError",
    "Iteration",
    "Kernel",
    "LaserGeometry",
    "LaserModel",
    "MapResult",
    "MapmendError",
    "MaxMixture",
    "OccupancyMap",
    "OdometryModel",
    "OptimizationResult",
    "OutputError",
    "PoseGraph",
    "RebuildResult",
    "ScanGraph",
    "ScanLog",
    "ScanMatch",
    "Scans",
    "Simulation",
    "SlipEvent",
    "StartedResult",
    "Switchable",
    "Trajectory",
    "TuneResult",
    "World",
    "__version__",
    "build_map",
    "check",
    "corridor_loop",
    "distrusted",
    "grid_of",
    "kernel_of",
    "marginals",
    "match",
    "named_file",
    "office_floor",
    "optimize",
    "optimize_from",
    "random_building",
    "read",
    "read_graph",
    "read_log",
    "read_toml",
    "read_trajectory",
    "rebuild",
    "relation_errors",
    "relative_errors",
    "simulate",
    "trajectory_errors",
    "tune",
    "write_graph",
    "write_run",
]


def __getattr__(name: str) -> Any:
    """The public names, from their modules (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'mapmend' has no attribute '{name}'")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
