"""What all tests share: a short log on disk, the command line called in this process, and how properties are tried."""

from dataclasses import dataclass

import pytest
from hypothesis import settings

from mapmend.cli import main
from mapmend.io.carmen import write_carmen
from mapmend.io.tum import write_tum
from mapmend.simulation import OdometryModel, corridor_loop, first_scans, simulate

# The same examples every time, however long a first call compiles: a red run has a reason.
settings.register_profile("same_examples", derandomize=True, deadline=None)
settings.load_profile("same_examples")

SCANS = 160


@pytest.fixture(scope="session")
def simulation():
    """The first 160 scans of the demo's building, 32 s of driving along its first corridor."""
    return first_scans(simulate(corridor_loop(), odometry=OdometryModel(rotation_bias_radpm=0.01), seed=3), SCANS)


@pytest.fixture(scope="session")
def log_path(simulation, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "short.clf"
    write_carmen(path, simulation.log)
    return path


@pytest.fixture(scope="session")
def truth_path(simulation, tmp_path_factory):
    path = tmp_path_factory.mktemp("truth") / "truth.tum"
    write_tum(path, simulation.log.stamps_s, simulation.truth)
    return path


@dataclass
class Answer:
    code: int
    out: str
    err: str

    @property
    def complaint(self):
        """The one line of an error."""
        lines = self.err.splitlines()
        assert len(lines) == 1, lines
        assert lines[0].startswith("mapmend: ")
        assert "Traceback" not in self.err
        return lines[0]


@pytest.fixture
def mapmend(capsys):
    """Calls the command line and gives its exit code and what it printed."""

    def call(*arguments):
        capsys.readouterr()
        code = main([str(a) for a in arguments])
        captured = capsys.readouterr()
        return Answer(code, captured.out, captured.err)

    return call
