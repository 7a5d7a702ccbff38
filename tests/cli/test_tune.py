"""``mapmend tune``: phi*, the graph, the picture, the verdict and its exit codes, and what it refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mapmend.commands.tune import lines
from mapmend.io.g2o import read_g2o, write_g2o
from mapmend.io.reader import read
from tests.consistency.scenes import room_graph
from tests.tuning.graphs import doubtful_room, hopeless_room

KEYS = {"phi", "measure", "curve", "consistent", "switched_off"}


@pytest.fixture(scope="module")
def graph():
    return doubtful_room(nodes=40)[0]


@pytest.fixture(scope="module")
def path(graph, tmp_path_factory):
    path = tmp_path_factory.mktemp("graphs") / "room.g2o"
    write_g2o(path, graph)
    return path


def test_a_folder_takes_graph_and_picture(mapmend, graph, path, tmp_path):
    answer = mapmend("tune", path, "-o", tmp_path / "out")
    assert answer.code == 0
    assert "the map is consistent" in answer.out
    assert "switched off 3 of 8 loops: 3 contradict the map" in answer.out
    tuned = read_g2o(tmp_path / "out" / "graph.g2o")
    assert np.hypot(*(tuned.poses - graph.poses)[:, :2].T).max() < 0.08
    assert len(tuned.scans) == len(graph)
    with Image.open(tmp_path / "out" / "tune.png") as picture:
        assert min(picture.size) > 500


def test_json_is_one_object_and_the_same_for_any_number_of_threads(mapmend, path, tmp_path):
    pages = []
    for threads in "13":
        answer = mapmend("tune", path, "-o", tmp_path / f"{threads}.toro", "--threads", threads, "--json")
        assert answer.code == 0
        pages.append(json.loads(answer.out))
        pages[-1].pop("seconds")
        assert pages[-1].pop("output") == str(tmp_path / f"{threads}.toro")
    assert pages[0] == pages[1]
    page = pages[0]
    assert set(page) >= KEYS
    assert page["consistent"] is True
    assert min(m for _, m in page["curve"]) == pytest.approx(page["measure"])
    assert [page["phi"]] == [phi for phi, m in page["curve"] if m == pytest.approx(page["measure"], rel=1e-12)][-1:]
    assert (tmp_path / "1.toro").read_bytes() == (tmp_path / "3.toro").read_bytes()
    assert len(read(tmp_path / "1.toro")) == 40
    assert (tmp_path / "tune.png").is_file()


def test_without_output_nothing_is_written(mapmend, path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert mapmend("tune", path, "--kernel", "cauchy", "--init", "given").code == 0
    assert not list(tmp_path.iterdir())


def test_loops_that_contradict_the_map_are_told_from_those_that_weigh_less(mapmend, path):
    page = json.loads(mapmend("tune", path, "--json").out)
    assert page["contradicting"] == sum(row["chi2"] > 11.345 for row in page["switched_off"]) == 3
    assert "agree" not in "\n".join(lines(page))
    said = "\n".join(lines(page | {"contradicting": 1}))
    assert "switched off 3 of 8 loops: 1 contradict the map" in said
    assert "the other 2 agree with it" in said
    assert "switched off no loop" in "\n".join(lines(page | {"switched_off": []}))


def test_the_other_minima_are_told_where_none_passes(mapmend, path):
    page = json.loads(mapmend("tune", path, "--json").out) | {"consistent": False}
    first = page["verdicts"][0]
    assert "minim" not in lines(page)[-1]
    assert (
        "at the other minimum of M fail too, p at most 0.004"
        in lines(page | {"verdicts": [first, first | {"p_value": 0.004}]})[-1]
    )
    assert (
        "at 2 other minima of M fail too, p at most 0.004"
        in lines(page | {"verdicts": [first, first | {"p_value": 0.004}, first | {"p_value": 0.0}]})[-1]
    )


def test_where_no_phi_gives_a_consistent_map_it_exits_with_1(mapmend, tmp_path):
    write_g2o(tmp_path / "wrong.g2o", hopeless_room())
    answer = mapmend("tune", tmp_path / "wrong.g2o")
    assert answer.code == 1
    assert "no phi gives a consistent map" in answer.out


def test_what_can_not_be_tuned_is_refused_in_one_line(mapmend, log_path, path, tmp_path):
    assert "holds no pose graph but a" in mapmend("tune", log_path).complaint
    write_g2o(tmp_path / "bare.g2o", replace(room_graph(5), scans=None))
    answer = mapmend("tune", tmp_path / "bare.g2o", "-o", tmp_path / "out")
    assert answer.code == 2
    assert "0 of 5 nodes carry a scan" in answer.complaint
    assert not (tmp_path / "out").exists()
    write_g2o(tmp_path / "chain.g2o", room_graph(5, with_loop=False))
    without_loops = mapmend("tune", tmp_path / "chain.g2o").complaint
    assert without_loops.endswith("the graph has no loop edges that a kernel could doubt; name one that has")
    broken = room_graph(12)
    broken.edges[5] = 3, 5
    write_g2o(tmp_path / "broken.g2o", broken)
    assert mapmend("tune", tmp_path / "broken.g2o").complaint.endswith("start along a tree")
    (tmp_path / "file").write_text("")
    assert "can't be written" in mapmend("tune", path, "-o", tmp_path / "file" / "x").complaint
    assert mapmend("tune", tmp_path / "nowhere.g2o").code == 2
    assert "--kernel" in mapmend("tune", path, "--kernel", "none").complaint
