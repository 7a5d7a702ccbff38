"""``mapmend compare``: methods in processes of their own, side by side."""

import json

import numpy as np
import pytest
from PIL import Image

from mapmend.cli import parser
from mapmend.commands.compare import COMPARED
from mapmend.geometry import se2
from mapmend.slam import METHODS


@pytest.fixture(scope="module")
def relations_path(simulation, tmp_path_factory):
    """True relations from the simulation's poses, each ten scans on."""
    path = tmp_path_factory.mktemp("relations") / "true.relations"
    stamps = simulation.log.stamps_s
    rows = np.arange(0, len(stamps) - 10, 5)
    steps = se2.between(simulation.truth[rows], simulation.truth[rows + 10])
    lines = [
        f"{stamps[k]:.6f} {stamps[k + 10]:.6f} {x} {y} 0 0 0 {t}" for k, (x, y, t) in zip(rows, steps, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_methods_side_by_side(mapmend, log_path, relations_path, tmp_path):
    folder = tmp_path / "out"
    methods = ["odometry", "go"]
    answer = mapmend("compare", log_path, "-o", folder, "--relations", relations_path, "--methods", *methods, "--json")
    assert answer.code == 0
    page = json.loads(answer.out)
    assert [row["method"] for row in page["methods"]] == methods
    odometry, go = page["methods"]
    assert go["translation_mean_m"] < 0.7 * odometry["translation_mean_m"]
    for row in page["methods"]:
        assert row["used"] == row["total"]
        assert 10.0 < row["peak_memory_mb"] < 2000.0
        assert 0.0 < row["seconds"] < 100.0
        assert row["consistent"] in (True, False, None)
        alone = json.loads(mapmend("eval", folder / row["method"], "--relations", relations_path, "--json").out)
        assert alone["translation_mean_m"] == pytest.approx(row["translation_mean_m"], abs=1e-6)
    assert json.loads((folder / "run.json").read_text())["methods"] == page["methods"]
    with Image.open(folder / "compare.png") as picture:
        assert picture.size[0] > 500


def test_without_relations_there_is_a_table_without_errors(mapmend, log_path, tmp_path):
    answer = mapmend("compare", log_path, "-o", tmp_path / "out", "--methods", "odometry")
    assert answer.code == 0
    assert "error" not in answer.out
    assert "odometry" in answer.out
    assert "compare.png" in answer.out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("no-such.clf",), "no-such.clf"),
        (("LOG", "--relations", "no-such.relations"), "no-such.relations"),
        (("LOG", "--methods", "go", "go"), "twice"),
        (("LOG", "--no-odometry"), "odometry"),
        (("BAD",), "bad.clf"),
    ],
)
def test_what_cannot_end_well_is_one_line(mapmend, log_path, tmp_path, arguments, complaint):
    (tmp_path / "bad.clf").write_text("FLASER 3 1.0\n")
    places = {"LOG": log_path, "BAD": tmp_path / "bad.clf"}
    answer = mapmend("compare", *(places.get(a, a) for a in arguments), "-o", tmp_path / "out")
    assert answer.code == 2
    assert complaint in answer.complaint
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.clf"]


def test_compare_takes_the_settings_that_map_takes():
    maps, compares = (vars(parser(name).parse_args([name, "-o", "OUT", "LOG"])) for name in ("map", "compare"))
    assert set(maps) - set(compares) <= {"method"}


def test_the_methods_compared_are_methods():
    assert set(COMPARED) <= set(METHODS)
