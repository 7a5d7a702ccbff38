"""What commands do to what is already where they write: logs, notes, reports, links, devices and inputs stay."""

import json
import os
import signal
import stat

import pytest

from mapmend.io.g2o import write_g2o
from tests.cli.interrupts import interrupted
from tests.consistency.scenes import room_graph
from tests.io.test_output import tree


@pytest.fixture(scope="module")
def graph_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("graphs") / "room.g2o"
    write_g2o(path, room_graph(30))
    return path


def mapped(mapmend, log, folder):
    answer = mapmend("map", log, "-o", folder, "--method", "odometry")
    assert answer.code == 0, answer.err
    return answer


def test_a_simulated_log_and_its_truth_stay_where_it_is_mapped_into_the_same_folder(mapmend, tmp_path):
    sim = tmp_path / "sim"
    simulate = ("simulate", "-o", sim, "--scans", 40)
    assert mapmend(*simulate).code == 0
    simulated = tree(sim)
    assert "kept" not in mapped(mapmend, sim / "log.clf", sim).err
    both = tree(sim)
    for name in ("log.clf", "truth.tum", "world.png"):
        assert both[name] == simulated[name]
    assert mapmend("eval", sim, "--reference", sim / "truth.tum").code == 0
    mapped(mapmend, sim / "log.clf", sim)  # and again
    answer = mapmend(*simulate, "--seed", 1)
    assert answer.code == 0
    assert "made from the output that was replaced: graph.g2o, map.pgm" in answer.err
    assert tree(sim)["log.clf"] != simulated["log.clf"]


def test_a_folder_of_another_program_with_a_run_json_is_refused_and_stays(mapmend, log_path, tmp_path):
    (tmp_path / "run.json").write_text("{}")
    (tmp_path / "thesis.tex").write_text("x")
    before = tree(tmp_path)
    for command in (("map", log_path), ("compare", log_path), ("simulate",), ("demo",)):
        answer = mapmend(*command, "-o", tmp_path)
        assert answer.code == 2
        assert "holds a run.json that is not mapmend's; name another folder" in answer.complaint
    assert tree(tmp_path) == before


def test_notes_and_the_log_in_the_folder_stay(mapmend, log_path, tmp_path):
    (tmp_path / "my.clf").write_bytes(log_path.read_bytes())
    (tmp_path / "notes.txt").write_text("mine")
    for _ in range(2):
        mapped(mapmend, tmp_path / "my.clf", tmp_path)
    assert (tmp_path / "my.clf").read_bytes() == log_path.read_bytes()
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "graph.g2o").exists()


def test_a_report_and_a_tuning_survive_the_next_map_and_are_said_to_be_of_the_older_one(mapmend, log_path, tmp_path):
    mapped(mapmend, log_path, tmp_path / "run")
    (tmp_path / "run" / "tune.json").write_text(json.dumps({"phi": 1.0, "curve": []}))
    assert mapmend("report", tmp_path / "run").code == 0
    report = (tmp_path / "run" / "report.html").read_bytes()
    answer = mapped(mapmend, log_path, tmp_path / "run")
    assert "kept, but made from the output that was replaced: report.html, tune.json" in answer.err
    assert (tmp_path / "run" / "report.html").read_bytes() == report
    again = mapmend("report", tmp_path / "run")
    assert again.code == 0
    assert "tune.json is of an older map and is left out; tune again" in again.err
    (tmp_path / "run" / "tune.json").write_text(json.dumps({"phi": 2.0, "curve": []}))
    assert "tune.json" not in mapmend("report", tmp_path / "run").err


def test_a_comparison_of_fewer_methods_keeps_the_other_runs_and_says_so(mapmend, log_path, tmp_path):
    for methods in (("odometry", "scanmatch"), ("odometry",)):
        answer = mapmend("compare", log_path, "-o", tmp_path / "beside", "--methods", *methods)
        assert answer.code == 0
    assert "made from the output that was replaced: scanmatch" in answer.err
    assert (tmp_path / "beside" / "scanmatch" / "map.png").exists()


def test_a_device_stays_a_device(mapmend, graph_path, log_path):
    was = os.stat(os.devnull)
    assert mapmend("optimize", graph_path, "-o", os.devnull).code == 0
    assert mapmend("convert", log_path, os.devnull, "--to", "carmen").code == 0
    assert "is a file; name a folder" in mapmend("map", log_path, "-o", os.devnull).complaint
    now = os.stat(os.devnull)
    assert stat.S_ISCHR(now.st_mode)
    assert (now.st_ino, now.st_rdev) == (was.st_ino, was.st_rdev)
    assert "No space left" in mapmend("optimize", graph_path, "-o", "/dev/full").complaint


def test_what_an_output_link_leads_to_is_written(mapmend, graph_path, log_path, tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "graph.g2o").write_text("old")
    (tmp_path / "graph.g2o").symlink_to("disk/graph.g2o")
    assert mapmend("optimize", graph_path, "-o", tmp_path / "graph.g2o").code == 0
    assert (tmp_path / "graph.g2o").is_symlink()
    assert "VERTEX_SE2" in (tmp_path / "disk" / "graph.g2o").read_text()
    (tmp_path / "run").symlink_to("disk/run")
    mapped(mapmend, log_path, tmp_path / "run")
    mapped(mapmend, log_path, tmp_path / "run")
    assert (tmp_path / "run").is_symlink()
    assert (tmp_path / "disk" / "run" / "run.json").exists()


def test_no_command_writes_over_its_input(mapmend, graph_path, log_path, tmp_path):
    graph = tmp_path / "graph.g2o"
    graph.write_bytes(graph_path.read_bytes())
    mapped(mapmend, log_path, tmp_path / "run")
    before = tree(tmp_path)
    run = tmp_path / "run"
    refused = [
        (("convert", graph, graph), "is the input"),
        (("convert", run, run / "trajectory.tum"), "is the input"),
        (("optimize", graph, "-o", graph), "is the input"),
        (("tune", graph, "-o", graph), "is the input"),
        (("tune", graph, "-o", tmp_path), "graph.g2o: is there"),
        (("tune", run, "-o", run), "holds a RUN"),
        (("report", run, "-o", run / "map.pgm"), "is the input"),
    ]
    for command, why in refused:
        answer = mapmend(*command)
        assert answer.code == 2
        assert why in answer.complaint
    assert tree(tmp_path) == before


def test_a_tuned_graph_is_not_tuned_in_its_own_place(mapmend, graph_path, tmp_path):
    for _ in range(2):
        assert mapmend("tune", graph_path, "-o", tmp_path / "tuned").code in (0, 1)
    before = tree(tmp_path)
    assert before.keys() == {"tuned", "tuned/graph.g2o", "tuned/tune.png", "tuned/run.json"}
    assert "is the input" in mapmend("tune", tmp_path / "tuned" / "graph.g2o", "-o", tmp_path / "tuned").complaint
    assert tree(tmp_path) == before
    (tmp_path / "tuned" / "run.json").unlink()  # as version 0.1.0 left it
    assert mapmend("tune", graph_path, "-o", tmp_path / "tuned").code in (0, 1)
    assert tree(tmp_path) == before


def test_pictures_and_reports_of_somebody_else_stay(mapmend, graph_path, log_path, tmp_path, monkeypatch):
    mapped(mapmend, log_path, tmp_path / "run")
    for name in ("check.png", "tune.png", "run/report.html"):
        (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\nmine")
    before = tree(tmp_path)
    monkeypatch.chdir(tmp_path)
    for command in (("check", graph_path), ("tune", graph_path, "-o", "new.g2o"), ("report", "run")):
        answer = mapmend(*command)
        assert answer.code == 2
        assert "is there, and not by mapmend" in answer.complaint
    assert tree(tmp_path) == before
    for name in ("check.png", "tune.png", "run/report.html"):
        (tmp_path / name).unlink()
    for _ in range(2):  # its own it replaces
        assert mapmend("check", graph_path).code == 0
        assert mapmend("tune", graph_path, "-o", "new.g2o").code in (0, 1)
        assert mapmend("report", "run").code == 0


@pytest.mark.parametrize("over_old", [False, True])
def test_sigterm_ends_a_command_as_ctrl_c_does(mapmend, log_path, tmp_path, over_old):
    if over_old:
        mapped(mapmend, log_path, tmp_path / "run")
    before = tree(tmp_path)
    done = interrupted("matching", "map", log_path, "-o", tmp_path / "run", number=signal.SIGTERM)
    assert done.returncode == 143
    lines = [line for line in done.stderr.splitlines() if "compiling kernels" not in line]
    assert lines == ["mapmend: terminated; nothing was written"]
    assert done.stdout == ""
    assert tree(tmp_path) == before
