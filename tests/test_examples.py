"""Every example runs, on a short log, and prints what its page promises."""

import re
import runpy
from pathlib import Path

import pytest

import mapmend
from mapmend.io.carmen import write_carmen
from mapmend.io.g2o import write_g2o
from mapmend.io.tum import write_tum
from mapmend.simulation import corridor_loop, first_scans, simulate

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short log, its truth, and its RUN."""
    place = tmp_path_factory.mktemp("examples")
    simulation = first_scans(simulate(corridor_loop(), seed=2), 120)
    write_carmen(place / "log.clf", simulation.log)
    write_tum(place / "truth.tum", simulation.log.stamps_s, simulation.truth)
    mapmend.write_run(mapmend.build_map(simulation.log), place / "run")
    return place


def run(name, *arguments):
    (path,) = EXAMPLES.glob(f"{name}_*.py")
    assert len(path.read_text().splitlines()) <= 50
    runpy.run_path(str(path))["main"](*map(str, arguments))


def test_01(folder, tmp_path, capsys):
    run("01", folder / "log.clf", tmp_path / "run")
    assert "120 scans" in capsys.readouterr().out
    assert (tmp_path / "run" / "map.png").is_file()


def test_02(capsys, monkeypatch):
    whole = mapmend.simulate
    monkeypatch.setattr(mapmend, "simulate", lambda *a, **k: first_scans(whole(*a, **k), 150))
    run("02")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["odometry", "scanmatch", "go"]


def test_03(folder, capsys):
    run("03", folder / "run")
    assert "least certain is node" in capsys.readouterr().out


def test_04(folder, capsys):
    run("04", folder / "run", folder / "log.clf", folder / "truth.tum")
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_05(folder, capsys):
    run("05", folder / "run" / "graph.g2o")
    none, gnc = capsys.readouterr().out.splitlines()
    assert none == "none: distrusts 0 edges, 0 of the 10 false"
    assert gnc.endswith("10 of the 10 false")


def test_06(folder, capsys):
    run("06", folder / "run" / "graph.g2o")
    verdict, scans = capsys.readouterr().out.splitlines()[:2]
    assert verdict.startswith("consistent")
    assert scans.startswith("0 of ")


def test_08(capsys):
    run("08")
    assert capsys.readouterr().out.startswith("converged: True")


def test_examples_import_mapmend_alone():
    for path in EXAMPLES.glob("*.py"):
        imports = re.findall(r"^(?:from|import) (mapmend\S*)", path.read_text(), re.MULTILINE)
        assert imports == ["mapmend"], path.name


def test_all_examples_are_run_here():
    assert sorted(p.name[:2] for p in EXAMPLES.glob("*.py")) == ["01", "02", "03", "04", "05", "06", "07", "08"]


def test_07(tmp_path, capsys):
    from tests.tuning.graphs import doubtful_room

    write_g2o(tmp_path / "graph.g2o", doubtful_room(nodes=40)[0])
    run("07", tmp_path / "graph.g2o", tmp_path / "best.g2o")
    assert "consistent: True" in capsys.readouterr().out
    assert (tmp_path / "best.g2o").is_file()
