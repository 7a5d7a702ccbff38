"""What the commands print and write when all is well."""

import filecmp
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mapmend as package
from mapmend import commands
from mapmend.commands import SUMMARIES
from mapmend.io.g2o import read_g2o
from mapmend.io.nav2 import read_map
from mapmend.io.reader import read, read_run
from mapmend.io.tum import read_tum
from mapmend.scan import ScanLog
from tests.real_data import data_path

RUN_FILES = ["graph.g2o", "map.pgm", "map.png", "map.yaml", "run.json", "trajectory.tum"]


@pytest.fixture(scope="module")
def run_folder(log_path, tmp_path_factory):
    from mapmend.cli import main

    folder = tmp_path_factory.mktemp("runs") / "igo"
    assert main(["map", str(log_path), "-o", str(folder), "--threads", "2"]) == 0
    return folder


def test_a_run_folder_is_complete(run_folder, simulation):
    assert sorted(p.name for p in run_folder.iterdir()) == RUN_FILES
    page = json.loads((run_folder / "run.json").read_text())
    assert page["method"] == "igo"
    assert page["mapmend"] == package.__version__
    first = page["mended"]["rounds"][0]
    assert first["matched"] >= page["counts"]["odometry_edges"]
    assert len(first["biased"]) == first["accepted"] <= first["changed"]
    assert set(page["seconds"]) == {"read", "compile", "match", "map", "write"}
    assert page["counts"]["scans"] == len(simulation.log)
    graph = read_g2o(run_folder / "graph.g2o")
    assert page["counts"]["nodes"] == len(graph)
    assert graph.scans is not None
    assert np.all(np.diff(graph.scans.offsets) == 180)
    grid = read_map(run_folder / "map.yaml")
    assert grid.image.shape == (page["map"]["rows"], page["map"]["columns"])
    assert set(np.unique(grid.image)) == {0, 205, 254}
    with Image.open(run_folder / "map.png") as picture:
        assert max(picture.size) <= 4000


def test_every_scan_has_its_pose_and_stamp(run_folder, simulation):
    trajectory, _ = read_run(run_folder)
    np.testing.assert_array_equal(trajectory.stamps_s, simulation.log.stamps_s)
    np.testing.assert_allclose(trajectory.poses[0], 0.0, atol=1e-12)


def test_the_same_bytes_twice_and_for_any_number_of_threads(mapmend, log_path, run_folder, tmp_path):
    again = mapmend("map", log_path, "-o", tmp_path / "again", "--threads", 1)
    assert again.code == 0
    _, differ, odd = filecmp.cmpfiles(run_folder, tmp_path / "again", RUN_FILES, shallow=False)
    assert not odd
    assert set(differ) <= {"run.json"}
    pages = [json.loads((folder / "run.json").read_text()) for folder in (run_folder, tmp_path / "again")]
    for page in pages:
        page.pop("seconds")
    assert pages[0] == pages[1]


def test_map_prints_a_summary_for_people(mapmend, log_path, tmp_path):
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--method", "odometry")
    assert answer.code == 0
    assert "160 scans" in answer.out
    assert "run/map.png" in answer.out


@pytest.mark.parametrize("method", ["odometry", "scanmatch", "go", "igo"])
def test_map_json(mapmend, log_path, tmp_path, method):
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--method", method, "--json", "--seed", 5)
    values = json.loads(answer.out)
    assert values["method"] == method
    assert values["seed"] == 5
    assert {"counts", "chi2_initial", "chi2_final", "seconds", "configuration", "run"} <= set(values)
    assert values["counts"]["key_nodes"] == 0 or method != "odometry"


def test_a_configuration_file_counts(mapmend, log_path, tmp_path):
    (tmp_path / "config.toml").write_text("seed = 7\n[grid]\ncell_size_m = 0.1\n")
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--config", tmp_path / "config.toml", "--json")
    values = json.loads(answer.out)
    assert values["seed"] == 7
    assert values["map"]["resolution_m"] == 0.1


def test_eval_against_a_reference(mapmend, run_folder, log_path, truth_path):
    errors = {}
    for name, path in (("igo", run_folder), ("odometry", log_path), ("file", run_folder / "trajectory.tum")):
        values = json.loads(mapmend("eval", path, "--reference", truth_path, "--json").out)
        assert values["frame"] == "robot"
        assert values["absolute_used"] == values["absolute_total"] == 160
        errors[name] = values["absolute_rmse_m"]
    assert errors["igo"] == errors["file"]
    assert "RMSE" in mapmend("eval", run_folder, "--reference", truth_path).out


def test_eval_against_relations(mapmend, simulation, log_path, truth_path, tmp_path):
    from mapmend.geometry.se2 import between

    truth, stamps = simulation.truth, simulation.log.stamps_s
    path = tmp_path / "true.relations"
    steps = between(truth[:-20], truth[20:])
    rows = zip(stamps[:-20], stamps[20:], steps, strict=True)
    path.write_text("".join(f"{a} {b} {x:.17g} {y:.17g} 0 0 0 {t:.17g}\n" for a, b, (x, y, t) in rows))
    perfect = json.loads(mapmend("eval", truth_path, "--relations", path, "--json").out)
    keys = {"translation_mean_m", "translation_std_m", "rotation_mean_deg", "rotation_std_deg", "used", "total"}
    assert keys <= set(perfect)
    assert perfect["used"] == perfect["total"] == 140
    assert perfect["translation_mean_m"] < 1e-9
    odometry = mapmend("eval", log_path, "--relations", path, "--laser-frame", "--json")
    assert json.loads(odometry.out)["frame"] == "laser"
    assert json.loads(odometry.out)["translation_mean_m"] > 0.01
    assert "laser sits" in mapmend("eval", truth_path, "--relations", path, "--laser-frame").complaint


@pytest.mark.parametrize(
    ("name", "frame", "translation", "rotation"),
    [("intel", [], "7.370", "39.17"), ("fr079", ["--laser-frame"], "6.507", "30.29")],
)
def test_raw_odometry_scores_what_is_published(mapmend, name, frame, translation, rotation):
    log, relations = data_path(f"logs/{name}.clf.bz2"), data_path(f"relations/{name}.relations")
    values = json.loads(mapmend("eval", log, "--relations", relations, "--json", *frame).out)
    assert f"{values['translation_mean_m']:.3f}" == translation
    assert f"{values['rotation_mean_deg']:.2f}" == rotation


def test_info(mapmend, log_path, run_folder):
    assert json.loads(mapmend("info", log_path, "--json").out)["scans"] == 160
    assert "160" in mapmend("info", log_path).out
    assert json.loads(mapmend("info", run_folder, "--json").out)["kind"] == "run"


@pytest.mark.parametrize("world", ["corridor", "office", "random"])
def test_simulate_writes_what_the_reader_reads_back(mapmend, tmp_path, world):
    arguments = ("simulate", "--world", world, "--seed", 4, "--slips", 1, "--scans", 40)
    values = json.loads(mapmend(*arguments, "-o", tmp_path / "a", "--json").out)
    assert values["scans"] == 40
    assert mapmend(*arguments, "-o", tmp_path / "b").code == 0
    log = read(tmp_path / "a" / "log.clf")
    assert isinstance(log, ScanLog)
    np.testing.assert_array_equal(read_tum(tmp_path / "a" / "truth.tum").stamps_s, log.stamps_s)
    files = ["log.clf", "truth.tum", "world.png", "run.json"]
    assert filecmp.cmpfiles(tmp_path / "a", tmp_path / "b", files, shallow=False)[0] == files


def test_demo_leaves_runs_truth_and_picture(mapmend, tmp_path, monkeypatch):
    from mapmend import simulation

    whole = simulation.simulate
    monkeypatch.setattr(simulation, "simulate", lambda *a, **k: simulation.first_scans(whole(*a, **k), 120))
    folder = tmp_path / "demo"
    answer = mapmend("demo", "-o", folder)
    assert answer.code == 0
    assert [line.split()[0] for line in answer.out.splitlines()[4:8]] == ["odometry", "scanmatch", "go", "igo"]
    assert {"log.clf", "truth.tum", "demo.png", "odometry", "scanmatch", "go", "igo"} <= {
        p.name for p in folder.iterdir()
    }
    picture = (folder / "demo.png").read_bytes()
    values = json.loads(mapmend("demo", "-o", folder, "--json").out)
    assert [row["method"] for row in values["methods"]] == ["odometry", "scanmatch", "go", "igo"]
    assert (folder / "demo.png").read_bytes() == picture


def test_no_help_loads_anything_heavy():
    """Neither the help of mapmend nor that of any of its commands."""
    script = (
        "import sys, mapmend, mapmend.cli, mapmend.commands\n"
        "mapmend.cli.parser().format_help()\n"
        "for name in mapmend.commands.SUMMARIES:\n"
        "    try:\n"
        "        mapmend.cli.main([name, '--help'])\n"
        "    except SystemExit as done:\n"
        "        assert done.code == 0\n"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'rich', 'PIL'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(f"usage: mapmend {name}" in done.stdout for name in SUMMARIES)


def test_every_command_has_a_file_and_every_file_is_a_command():
    names = {path.stem for path in Path(commands.__file__).parent.glob("*.py")}
    assert names - {"__init__", "compare_child"} == set(SUMMARIES)
