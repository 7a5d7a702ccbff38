"""The page without a browser: what it holds, what it never holds, and what it is made from."""

import json
import re
from base64 import b64decode, b64encode
from hashlib import sha256
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mapmend.cli import main
from mapmend.config import Config
from mapmend.consistency.check import check
from mapmend.errors import InputError
from mapmend.graph.optimizer import edge_chi2
from mapmend.io.nav2 import read_map
from mapmend.maps import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from mapmend.report import embedding
from mapmend.report.embedding import packed, packed_map, safe_json
from mapmend.report.page import report_page
from mapmend.report.run_data import _scans, read_checked, run_values
from mapmend.scan import LaserGeometry, Scans
from tests.report.conftest import NODES, room_run


def unpacked(value):
    return np.frombuffer(b64decode(value["base64"]), np.dtype(value["kind"]).newbyteorder("<"))


def data_of(text):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)[1])


@pytest.fixture(scope="module")
def page(runs):
    return report_page([read_checked(runs["wrong"][0], Config())])


def test_the_page_is_whole_in_itself(page):
    body = page.replace(re.search(r'id="data">(.*?)</script>', page, re.S)[1], "")
    body = body.replace('"http://www.w3.org/2000/svg"', "")  # a name, which nothing fetches
    assert not re.search(r"https?:|//[a-z]|\bsrc=|\bhref=|@import|url\(|fetch\(|XMLHttp", body)
    assert "default-src 'none'" in page
    assert "{" + "data}" not in page
    assert page.count("<script") == page.count("</script>") == 2


def test_the_policy_names_just_the_pages_own_program(page):
    for tag, name in (("style", "style-src"), ("script", "script-src")):
        text = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.S)[-1]
        source = b64encode(sha256(text.encode()).digest()).decode()
        assert f"{name} 'sha256-{source}'" in page


def test_data_are_the_graphs_and_the_checks(runs, page):
    folder, graph = runs["wrong"]
    result = check(graph)
    (run,) = data_of(page)["runs"]
    assert run["name"] == "wrong"
    assert (run["verdict"]["consistent"], run["verdict"]["p_value"]) == (False, result.p_value)
    np.testing.assert_allclose(unpacked(run["nodes"]["pose"]).reshape(-1, 3), graph.poses, atol=1e-6)
    np.testing.assert_array_equal(unpacked(run["nodes"]["id"]), graph.ids)
    np.testing.assert_array_equal(np.flatnonzero(unpacked(run["nodes"]["is_key"])), [0, 20, 40, 60])
    np.testing.assert_array_equal(unpacked(run["nodes"]["failed"]), result.scans.failed)
    np.testing.assert_allclose(unpacked(run["nodes"]["t_s"]), 0.5 * np.arange(NODES))
    np.testing.assert_allclose(unpacked(run["edges"]["chi2"]), edge_chi2(graph), rtol=1e-4, atol=1e-6)
    np.testing.assert_array_equal(unpacked(run["edges"]["kind"]), [0] * (NODES - 1) + [2, 2])
    np.testing.assert_allclose(
        unpacked(run["points"]).reshape(-1, 2), result.views.points_in_map()[result.points], atol=1e-5
    )
    assert [region["nodes"] for region in run["regions"]] == [region.scans.tolist() for region in result.regions]
    picture = Image.open(BytesIO(b64decode(run["map"]["png"])))
    grid = read_map(folder / "map.yaml")
    assert picture.size == grid.image.shape[::-1]
    assert np.array_equal(np.asarray(picture.convert("L"))[::-1] < 100, grid.image == OCCUPIED)


def test_scans_come_back_within_a_millimetre(runs):
    values = run_values(read_checked(runs["right"][0], Config()))["scans"]
    readings = unpacked(values["readings"]) / values["per_m"]
    true = runs["right"][1].scans.ranges_m
    np.testing.assert_allclose(readings, np.where(np.isfinite(true), true, 0.0), atol=1.01e-3)
    assert unpacked(values["offsets"])[-1] == len(readings)


def test_too_many_readings_are_thinned_beam_by_beam(runs, monkeypatch):
    monkeypatch.setattr("mapmend.report.run_data.MOST_READINGS", NODES * 60)
    values = run_values(read_checked(runs["right"][0], Config()))["scans"]
    assert np.all(np.diff(unpacked(values["offsets"])) == 60)
    assert values["lasers"][0][1] == pytest.approx(3.0 * np.pi / 180.0)


_names = st.one_of(
    st.text(), st.sampled_from(["</script><script>x()</script>", "<!--<script>", "]]>", "\u2028'\"&amp;"])
)


@settings(max_examples=60, deadline=None)
@given(_names)
def test_no_name_breaks_out_of_the_data(name):
    text = safe_json({name: [name]})
    assert not set("<>&\u2028\u2029") & set(text)
    assert json.loads(text) == {name: [name]}


def test_names_are_text_wherever_they_stand(tmp_path):
    evil = "<img src=x onerror=alert(1)>{data}"
    room_run(tmp_path / evil, log="</script><script>alert(2)<!--.clf")
    text = report_page([read_checked(tmp_path / evil, Config())])
    assert "<img" not in text
    assert "alert(2)<" not in text
    assert text.count("</script>") == 2
    run = data_of(text)["runs"][0]
    assert run["name"] == evil
    assert run["page"]["log"].endswith("script><script>alert(2)<!--.clf")


@pytest.mark.parametrize("kind", ["float32", "float64", "int32", "uint16", "uint8"])
def test_arrays_are_packed_as_they_are(kind):
    values = np.arange(7).astype(kind)
    np.testing.assert_array_equal(unpacked(packed(values, kind)), values)


@pytest.mark.parametrize(
    ("values", "kind"), [([255, 256], "uint8"), ([-1], "uint16"), ([2**31], "int32"), ([0.5], "uint8")]
)
def test_what_does_not_fit_is_not_packed(values, kind):
    with pytest.raises(OverflowError, match=kind):
        packed(values, kind)


def test_scans_of_many_lasers_keep_theirs():
    """A laser that never turns at the same speed has a geometry of its own in every scan."""
    geometries = tuple(LaserGeometry(2, -1.0, 0.5 + 0.001 * k, 30.0) for k in range(300))
    scans = Scans(np.ones(600, np.float32), 2 * np.arange(301), np.arange(300, dtype=np.int32), geometries)
    values = _scans(scans)
    np.testing.assert_array_equal(unpacked(values["laser"]), np.arange(300))
    assert values["lasers"][256][1] == 0.5 + 0.256


def test_large_maps_are_shrunk_and_keep_their_walls(monkeypatch):
    image = np.full((101, 50), FREE, np.uint8)
    image[40], image[:, 49] = OCCUPIED, UNKNOWN
    monkeypatch.setattr(embedding, "MOST_PIXELS", 600)
    values = packed_map(OccupancyMap(image, 0.1, (-1.0, 2.0, 0.0)))
    assert (values["cell_m"], values["x_m"], values["y_m"]) == (pytest.approx(0.3), -1.0, 2.0)
    assert values["height_m"] == pytest.approx(34 * 0.3)
    cells = np.asarray(Image.open(BytesIO(b64decode(values["png"]))).convert("L"))[::-1]
    assert np.all(cells[13] < 100)


def test_command(runs, tmp_path, capsys):
    (right, _), (wrong, _) = runs["right"], runs["wrong"]
    assert main(["report", str(right), "--compare", str(wrong), "-o", str(tmp_path / "r.html"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["bytes"] == (tmp_path / "r.html").stat().st_size
    assert [(run["name"], run["consistent"]) for run in told["runs"]] == [("right", True), ("wrong", False)]


def test_what_is_no_run_is_refused_in_one_line(tmp_path, runs, capsys):
    (tmp_path / "empty").mkdir()
    for folder, what in ((tmp_path / "none", "trajectory.tum"), (tmp_path / "empty", "trajectory.tum")):
        assert main(["report", str(folder)]) == 2
        error = capsys.readouterr().err
        assert what in error
        assert error.count("\n") == 1
    assert not list((tmp_path / "empty").iterdir())
    assert main(["report", str(runs["right"][0]), "-o", str(tmp_path)]) == 2
    assert "is a directory" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "[]", "{", '"a"'])
def test_a_damaged_run_file_is_named(tmp_path, text):
    room_run(tmp_path / "run")
    (tmp_path / "run" / "run.json").write_text(text)
    with pytest.raises(InputError, match=r"run\.json"):
        read_checked(tmp_path / "run", Config())


def test_a_damaged_tune_file_is_named(tmp_path):
    room_run(tmp_path / "run")
    (tmp_path / "run" / "tune.json").write_text("[")
    with pytest.raises(InputError, match=r"tune\.json"):
        read_checked(tmp_path / "run", Config())


def test_an_older_run_is_shown_without_what_it_does_not_tell(tmp_path):
    room_run(tmp_path / "run")
    path = tmp_path / "run" / "run.json"
    page = json.loads(path.read_text())
    for key in ("key_nodes", "configuration", "counts", "seconds"):
        del page[key]
    path.write_text(json.dumps(page))
    values = run_values(read_checked(tmp_path / "run", Config()))
    assert not values["nodes"]["knows_key_nodes"]
    assert values["settings"] == []
