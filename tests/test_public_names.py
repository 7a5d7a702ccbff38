"""The Python interface: its names, that each says what it does, and that importing mapmend loads nothing."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mapmend

NAMES = [
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
"""Under semantic versioning: a name that is taken away, or whose meaning changes, makes a new major version."""


def test_the_public_names_are_these():
    assert sorted(mapmend.__all__) == sorted(NAMES)
    assert dir(mapmend) == sorted(NAMES)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        mapmend.nothing  # noqa: B018


@pytest.mark.parametrize("name", [name for name in NAMES if name != "__version__"])
def test_a_public_name_says_what_it_does(name):
    value = getattr(mapmend, name)
    # A dataclass without a docstring is given its signature.
    assert (value.__doc__ or "").strip()
    assert not value.__doc__.startswith(f"{name}(")
    assert value.__module__.startswith("mapmend.")
    if inspect.isfunction(value):
        hints = {**value.__annotations__}
        assert "return" in hints
        assert set(inspect.signature(value).parameters) <= set(hints)


def test_the_docs_name_them_all():
    text = (Path(__file__).parents[1] / "docs" / "python.md").read_text()
    named = set(re.findall(r"`(\w+)[`(.]", text))
    assert set(NAMES) - {"__version__"} <= named


def test_importing_mapmend_loads_nothing_heavy():
    script = (
        "import sys, mapmend\n"
        "dir(mapmend), mapmend.MapmendError, mapmend.__version__\n"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'rich', 'PIL'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_what_is_no_config_is_refused_by_all_that_take_one(simulation, tmp_path):
    config = mapmend.Config()
    graph = mapmend.build_map(simulation.log, "odometry").graph
    for call in (
        lambda wrong: mapmend.check(graph, wrong),
        lambda wrong: mapmend.tune(graph, wrong),
        lambda wrong: mapmend.rebuild(graph, wrong),
        lambda wrong: mapmend.build_map(simulation.log, "igo", wrong),
    ):
        for wrong in (config.consistency, {"scan": {}}, None):
            with pytest.raises(mapmend.MapmendError, match="the settings must be a Config, got "):
                call(wrong)
