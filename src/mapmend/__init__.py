"""mapmend: 2D laser SLAM that mends its own graph and checks whether the map can be trusted.

    log = mapmend.read_log("intel.clf.bz2")
    result = mapmend.build_map(log)
    mapmend.write_run(result, "intel-run")

Names are loaded when they are first used, so that importing mapmend takes no time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from mapmend.version import VERSION

if TYPE_CHECKING:
    from mapmend.config import Config as Config
    from mapmend.consistency.check import CheckResult as CheckResult
    from mapmend.consistency.check import check as check
    from mapmend.errors import MapmendError as MapmendError
    from mapmend.io.read_log import read_log as read_log
    from mapmend.io.reader import read as read
    from mapmend.run_folder import write_run as write_run
    from mapmend.slam import MapResult as MapResult
    from mapmend.slam import RebuildResult as RebuildResult
    from mapmend.slam import build_map as build_map
    from mapmend.slam import rebuild as rebuild
    from mapmend.tuning.tune import TuneResult as TuneResult
    from mapmend.tuning.tune import tune as tune

__version__ = VERSION

_HOMES = {
    "CheckResult": "mapmend.consistency.check",
    "Config": "mapmend.config",
    "MapResult": "mapmend.slam",
    "MapmendError": "mapmend.errors",
    "RebuildResult": "mapmend.slam",
    "TuneResult": "mapmend.tuning.tune",
    "build_map": "mapmend.slam",
    "check": "mapmend.consistency.check",
    "read": "mapmend.io.reader",
    "read_log": "mapmend.io.read_log",
    "rebuild": "mapmend.slam",
    "tune": "mapmend.tuning.tune",
    "write_run": "mapmend.run_folder",
}

__all__ = [
    "CheckResult",
    "Config",
    "MapResult",
    "MapmendError",
    "RebuildResult",
    "TuneResult",
    "__version__",
    "build_map",
    "check",
    "read",
    "read_log",
    "rebuild",
    "tune",
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
