"""``mapmend check``: its verdicts, its exit codes, its picture, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mapmend.io.g2o import write_g2o
from mapmend.scan import LaserGeometry, Scans
from tests.cli.interrupts import interrupted
from tests.consistency.scenes import graph_of, room_graph

KEYS = {"consistent", "p_value", "scans", "scans_inconsistent", "pairs", "pairs_failed", "suspect_edges"}


@pytest.fixture(scope="module")
def right_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("graphs") / "right.g2o"
    write_g2o(path, room_graph(80))
    return path


@pytest.fixture(scope="module")
def wrong_path(tmp_path_factory):
    graph = room_graph(80)
    poses = graph.poses.copy()
    poses[40:, 0] += 0.4
    path = tmp_path_factory.mktemp("graphs") / "wrong.g2o"
    write_g2o(path, graph_of(poses, graph.scans, [(0, 79)]))  # its loop edge says so too
    return path


def test_a_consistent_map_exits_with_0(mapmend, right_path, tmp_path):
    answer = mapmend("check", right_path, "-o", tmp_path / "out")
    assert answer.code == 0
    assert "the map is consistent" in answer.out
    with Image.open(tmp_path / "out" / "check.png") as picture:
        assert min(picture.size) > 300


def test_an_inconsistent_map_exits_with_1_and_says_where(mapmend, wrong_path, tmp_path):
    answer = mapmend("check", wrong_path, "-o", tmp_path)
    assert answer.code == 1
    assert "INCONSISTENT" in answer.out
    assert "region" in answer.out
    assert "0-790" in answer.out


@pytest.mark.parametrize(("which", "code"), [("right_path", 0), ("wrong_path", 1)])
def test_json(mapmend, request, tmp_path, which, code):
    answer = mapmend("check", request.getfixturevalue(which), "-o", tmp_path, "--json")
    assert answer.code == code
    values = json.loads(answer.out)
    assert set(values) >= KEYS
    assert values["consistent"] is (code == 0)
    assert values["scans"] == values["scans_tested"] == 80
    assert (tmp_path / "check.png").is_file()
    if code:
        assert values["suspect_edges"][0]["from"] == 0
        assert values["suspect_edges"][0]["to"] == 790


def test_the_same_bytes_for_any_number_of_threads(mapmend, wrong_path, tmp_path):
    outs = [mapmend("check", wrong_path, "-o", tmp_path / n, "--threads", n, "--json").out for n in "13"]
    assert outs[0].replace(str(tmp_path / "1"), "") == outs[1].replace(str(tmp_path / "3"), "")
    assert (tmp_path / "1" / "check.png").read_bytes() == (tmp_path / "3" / "check.png").read_bytes()


def test_a_run_is_checked_as_it_stands(mapmend, log_path, tmp_path):
    assert mapmend("map", log_path, "-o", tmp_path / "run").code == 0
    answer = mapmend("check", tmp_path / "run")
    assert answer.code == 0
    assert (tmp_path / "run" / "check.png").is_file()


def test_settings_count(mapmend, wrong_path, tmp_path):
    (tmp_path / "c.toml").write_text("[consistency]\nmin_points = 100000\n")
    answer = mapmend("check", wrong_path, "-o", tmp_path, "--config", tmp_path / "c.toml")
    assert answer.code == 0
    assert "nothing was tested" in answer.err


def test_what_can_not_be_checked_is_refused_in_one_line(mapmend, log_path, tmp_path):
    assert "holds no pose graph but a" in mapmend("check", log_path).complaint
    bare = tmp_path / "bare.g2o"
    write_g2o(bare, replace(room_graph(5), scans=None))
    answer = mapmend("check", bare)
    assert answer.code == 2
    assert "0 of 5 nodes carry a scan" in answer.complaint
    assert "name a graph whose nodes carry their scans" in answer.complaint
    assert mapmend("check", tmp_path / "nowhere.g2o").code == 2
    (tmp_path / "file").write_text("")
    assert "can't be written" in mapmend("check", bare, "-o", tmp_path / "file" / "x").complaint
    assert "no RUN folder" in mapmend("check", tmp_path).complaint


def test_an_error_that_is_not_about_scans_names_no_scans(mapmend, tmp_path):
    wide = LaserGeometry(2, -1.6, 3.2, 20.0)
    sparse = replace(
        room_graph(12), scans=Scans(np.ones(24, np.float32), 2 * np.arange(13), np.zeros(12, np.int32), (wide,))
    )
    write_g2o(tmp_path / "sparse.g2o", sparse)
    for command in ("check", "tune"):
        answer = mapmend(command, tmp_path / "sparse.g2o")
        assert answer.code == 2
        assert answer.complaint.endswith("3.2 rad apart: no free space is known between them")


def test_a_picture_that_can_not_be_written_is_refused_before_the_work(mapmend, right_path, tmp_path, monkeypatch):
    def never(*_, **__):
        raise AssertionError("worked first")

    monkeypatch.setattr("mapmend.consistency.check.check", never)
    (tmp_path / "check.png").mkdir()
    answer = mapmend("check", right_path, "-o", tmp_path)
    assert answer.code == 2
    assert "check.png: is a directory" in answer.complaint


@pytest.mark.parametrize("stage", ["scales", "compare", "loops"])
def test_an_interrupted_check_stops_cleanly(right_path, tmp_path, stage):
    done = interrupted(stage, "check", right_path, "-o", tmp_path)
    assert done.returncode == 130
    assert [line for line in done.stderr.splitlines() if line.startswith("mapmend:")] == [
        "mapmend: interrupted; nothing was written"
    ]
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_scans_without_a_node_are_refused(mapmend, tmp_path):
    lost = tmp_path / "lost.g2o"
    write_g2o(tmp_path / "whole.g2o", room_graph(3, with_loop=False))
    text = (tmp_path / "whole.g2o").read_text().splitlines()
    first_scan = next(k for k, line in enumerate(text) if line.startswith("ROBOTLASER1"))
    lost.write_text("\n".join([text[first_scan], *text[:first_scan], *text[first_scan + 1 :]]) + "\n")
    answer = mapmend("check", lost)
    assert answer.code == 2
    assert "lost.g2o:1" in answer.complaint
