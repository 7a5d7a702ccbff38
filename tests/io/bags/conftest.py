"""A short log, and the command line called in this process."""

import pytest

from mapmend.commands.simulate import first_scans
from mapmend.simulation import corridor_loop, simulate
from tests.cli.conftest import log_path, mapmend, simulation  # noqa: F401


@pytest.fixture(scope="session")
def log():
    """24 s of a simulated drive."""
    return first_scans(simulate(corridor_loop(), seed=3), 120).log
