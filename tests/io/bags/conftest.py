"""A short log, as the bags of the tests hold it."""

import pytest

from mapmend.commands.simulate import first_scans
from mapmend.simulation import corridor_loop, simulate


@pytest.fixture(scope="session")
def log():
    """24 s of a simulated drive."""
    return first_scans(simulate(corridor_loop(), seed=3), 120).log
