"""A short log, as the bags of the tests hold it."""

import pytest

from mapmend.simulation import corridor_loop, first_scans, simulate


@pytest.fixture(scope="session")
def log():
    """24 s of a simulated drive."""
    return first_scans(simulate(corridor_loop(), seed=3), 120).log
