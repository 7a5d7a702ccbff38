import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from mapmend.errors import InputError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io import graph_lines
from mapmend.io.g2o import read_g2o, write_g2o
from mapmend.io.graph_lines import parse_graph
from mapmend.io.toro import read_toro, write_toro
from tests.io.samples import assert_same_scans, graphs, robotlaser, short_graph
from tests.real_data import data_path


def read(text: str) -> PoseGraph:
    return parse_graph(text.encode(), "sample.g2o")


def assert_same_graph(got: PoseGraph, expected: PoseGraph) -> None:
    for name in ("poses", "ids", "edges", "measurements", "information", "is_loop"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name), err_msg=name)
    assert got.fixed == expected.fixed
    assert (got.stamps_s is None) == (expected.stamps_s is None)
    if expected.stamps_s is not None:
        np.testing.assert_array_equal(got.stamps_s, expected.stamps_s)
    assert (got.scans is None) == (expected.scans is None)
    if expected.scans is not None:
        assert_same_scans(got.scans, expected.scans)


@settings(max_examples=60, deadline=None)
@given(graphs())
@pytest.mark.parametrize(("write", "read_back"), [(write_g2o, read_g2o), (write_toro, read_toro)])
def test_written_graph_reads_back_the_same(tmp_path_factory, write, read_back, graph):
    path = tmp_path_factory.mktemp("graph") / "graph"
    write(path, graph)
    assert_same_graph(read_back(path), graph)


def test_short_graph_is_read():
    graph = read(short_graph())
    assert (len(graph), len(graph.edges), graph.fixed) == (4, 4, (0,))
    assert graph.is_loop.tolist() == [False, False, False, True]
    assert graph.stamps_s.tolist() == [0.5, 1.5, 2.5, 3.5]
    assert np.diff(graph.scans.offsets).tolist() == [3, 3, 3, 3]
    np.testing.assert_allclose(graph.scans.geometry_of(0).T_robot_laser, (0.0995, -0.00998, 0.0), atol=1e-5)


def test_stream_gets_what_the_file_gets(tmp_path):
    graph, stream = read(short_graph()), io.StringIO()
    write_g2o(tmp_path / "g.g2o", graph)
    write_g2o(stream, graph)
    assert stream.getvalue() == (tmp_path / "g.g2o").read_text()
    words = [line.split()[0] for line in stream.getvalue().splitlines()[:4]]
    assert words == ["VERTEX_SE2", "ROBOTLASER1"] * 2


def test_orders_of_the_information_matrix():
    expected = np.array([[5.0, 0.1, 0.2], [0.1, 6.0, 0.3], [0.2, 0.3, 7.0]])
    g2o = read("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nEDGE_SE2 0 1 1 0 0 5 0.1 0.2 6 0.3 7\n")
    toro = read("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 5 0.1 6 7 0.2 0.3\n")
    np.testing.assert_array_equal(g2o.information[0], expected)
    np.testing.assert_array_equal(toro.information[0], expected)


def test_toro_writes_its_own_words(tmp_path):
    write_toro(tmp_path / "g.toro", read("VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nEDGE2 0 1 1 0 0 5 0.1 6 7 0.2 0.3\n"))
    assert (tmp_path / "g.toro").read_text().splitlines()[2] == "EDGE2 0 1 1.0 0.0 0.0 5.0 0.1 6.0 7.0 0.2 0.3"


def test_backward_edges_comments_exponents_and_windows_line_ends():
    text = "VERTEX_SE2 7 0 0 0\r\nVERTEX_SE2 9 1 0 0\r\nVERTEX_SE2 2 1.5e+000 0 0\r\n#LOOP EDGES\r\n"
    graph = read(
        text + "EDGE_SE2 2 7 1 0 0 1.121636e+002 0 0 1.121636e+002 0 1e3\r\nEDGE_SE2 9 7 1 0 0 1 0 0 1 0 1\r\n"
    )
    assert graph.edges.tolist() == [[2, 0], [1, 0]]
    assert graph.is_loop.tolist() == [True, False]  # 9 and 7 stand next to each other in the file
    assert graph.information[0, 0, 0] == 112.1636
    assert graph.fixed == (0,)


def test_nodes_without_scan_have_empty_ones():
    graph = read(f"VERTEX_SE2 0 0 0 0\n{robotlaser()}\nVERTEX_SE2 1 1 0 0\n")
    assert np.diff(graph.scans.offsets).tolist() == [3, 0]
    assert graph.stamps_s[0] == 10.5
    assert np.isnan(graph.stamps_s[1])
    assert read("VERTEX_SE2 0 0 0 0\n").scans is None


def test_fix_names_several_vertices():
    assert read("VERTEX_SE2 5 0 0 0\nVERTEX_SE2 6 1 0 0\nFIX 6 5\n").fixed == (0, 1)


TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"
BAD_GRAPHS = {
    "duplicate vertex": (TWO + "VERTEX_SE2 0 2 0 0\n", 3),
    "edge to itself": (TWO + "EDGE_SE2 1 1 1 0 0 1 0 0 1 0 1\n", 3),
    "not positive definite": (TWO + "EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n", 3),
    "singular": (TWO + "EDGE_SE2 0 1 1 0 0 1 0 0 0 0 1\n", 3),
    "second of two edges is bad": (TWO + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n", 4),
    "nan measurement": (TWO + "EDGE_SE2 0 1 nan 0 0 1 0 0 1 0 1\n", 3),
    "infinite information": (TWO + "EDGE_SE2 0 1 1 0 0 inf 0 0 1 0 1\n", 3),
    "nan pose": ("VERTEX_SE2 0 0 nan 0\n", 1),
    "pose no number": ("VERTEX_SE2 0 0 zero 0\n", 1),
    "absurd pose": ("VERTEX_SE2 0 0 1e200 0\n", 1),
    "truncated vertex": ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0\n", 2),
    "truncated edge": (TWO + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0\n", 3),
    "id no whole number": ("VERTEX_SE2 0.5 0 0 0\n", 1),
    "edge id no whole number": (TWO + "EDGE_SE2 0 1.5 1 0 0 1 0 0 1 0 1\n", 3),
    "fix of a missing vertex": (TWO + "FIX 3\n", 3),
    "fix of nothing": (TWO + "FIX\n", 3),
    "scan before any vertex": (robotlaser() + "\n" + TWO, 1),
    "second scan": ("VERTEX_SE2 0 0 0 0\n" + robotlaser() + "\n" + robotlaser() + "\n", 3),
    "truncated scan": ("VERTEX_SE2 0 0 0 0\nROBOTLASER1 0 -1.57 3.14 0.0174 80.0 0.01 0 3 1.0 2.0\n", 2),
    "scan with nan": ("VERTEX_SE2 0 0 0 0\n" + robotlaser("1.0 nan 2.0") + "\n", 2),
}


@pytest.mark.parametrize("name", BAD_GRAPHS)
def test_bad_graph_is_refused_with_its_line(name):
    text, line = BAD_GRAPHS[name]
    with pytest.raises(InputError) as caught:
        read(text)
    assert caught.value.line == line
    assert caught.value.mend


@pytest.mark.parametrize("text", ["", "\n", "FIX 0\n", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n"])
def test_file_without_vertices_and_edges_is_refused(text):
    with pytest.raises(InputError):
        read(text)


REAL = {
    "scangraphs/intel.toro.gz": (2672, 2671, 1230, 0.0),
    "scangraphs/fr079.toro.gz": (1464, 1463, 844, -0.04),
    "scangraphs/killian.g2o.gz": (3873, 3872, 1115, 0.0),
    "posegraphs/intel.g2o.gz": (943, 942, 895, None),
    "posegraphs/M3500.g2o.gz": (3500, 3499, 1954, None),
    "posegraphs/M3500a.g2o.gz": (3500, 3499, 1954, None),
    "posegraphs/ringCity.g2o.gz": (2361, 2360, 901, None),
    "posegraphs/ringCity.groundtruth.g2o.gz": (2361, 2360, 901, None),
    "posegraphs/bicocca25b_0.000.g2o.gz": (8358, 8357, 446, None),
    "posegraphs/bicocca25b_0.200.g2o.gz": (8358, 8357, 304, None),
    "posegraphs/bicocca25b_0.500.g2o.gz": (8358, 8357, 122, None),
}


@pytest.mark.parametrize("name", REAL)
def test_real_graph(name, tmp_path):
    nodes, odometry, loops, x = REAL[name]
    graph = read_g2o(data_path(name))
    assert (len(graph), int(np.sum(~graph.is_loop)), int(np.sum(graph.is_loop))) == (nodes, odometry, loops)
    if x is not None:
        assert np.all(np.diff(graph.scans.offsets) > 0)
        assert {g.T_robot_laser for g in graph.scans.geometries} == {(x, 0.0, 0.0)}
        assert graph.scans.ranges_m[np.isfinite(graph.scans.ranges_m)].max() < 50.0
    write_g2o(tmp_path / "graph.g2o", graph)
    assert_same_graph(read_g2o(tmp_path / "graph.g2o"), graph)


ODD = (
    "VERTEX_SE2 0 0 0 0\n\nVERTEX_SE2 1 1 0 0\n",
    "VERTEX_SE2 0 0 0 0 # the first\n",
    "VERTEX_SE2 0 0 0 nan\n",
    "VERTEX_SE2 0 0 0 1e400\n",
    "VERTEX_SE2 0 0 0\n",
    "VERTEX_SE2 0 0 0 0\nVERTEX2 1 1 0 0\n",
    "FIX 0 0 0 0\nVERTEX_SE2 0 0 0 0\n",
)


@pytest.mark.parametrize("text", ODD)
def test_what_is_odd_is_read_line_by_line(text):
    assert graph_lines._vertices_and_edges(text.encode()) is None


@pytest.mark.parametrize("ends", ["\n", "\r\n", ""])
@pytest.mark.parametrize(
    "words", [("VERTEX_SE2", "EDGE_SE2", "55 1 2 66 3 77"), ("VERTEX2", "EDGE2", "55 1 66 77 2 3")]
)
def test_read_at_once_or_line_by_line_a_graph_is_the_same(words, ends, monkeypatch):
    vertex, edge, information = words
    lines = [f"{vertex} 5 0.25 -1e-3 3.1", f"{vertex} 7 1 0.12345678901234567 -2", f"{vertex}  9 2 0 0"]
    lines += [f"{edge} 5 7 1 0 0.1 {information}", f"{edge} 9 7 1 .5 -0.1 {information}"]
    data = ((ends or "\n").join(lines) + ends).encode()
    assert graph_lines._vertices_and_edges(data) is not None
    at_once = graph_lines.parse_graph(data, "graph")
    monkeypatch.setattr(graph_lines, "_vertices_and_edges", lambda data: None)
    by_line = graph_lines.parse_graph(data, "graph")
    for name in ("poses", "ids", "edges", "measurements", "information", "is_loop"):
        np.testing.assert_array_equal(getattr(at_once, name), getattr(by_line, name))


def test_our_graphs_are_whole_to_readers_that_stop_at_a_comment():
    """GTSAM's reader takes no edge behind a line that it does not know; scans do not disturb it."""
    graph = read(short_graph())
    graph = replace(graph, fixed=(1,), is_loop=~graph.is_loop)
    stream = io.StringIO()
    write_g2o(stream, graph)
    words = [line.split()[0] for line in stream.getvalue().splitlines()]
    last_edge = len(words) - 1 - words[::-1].index("EDGE_SE2")
    assert set(words[: last_edge + 1]) <= {"VERTEX_SE2", "ROBOTLASER1", "EDGE_SE2"}
    assert_same_graph(read(stream.getvalue()), graph)


def test_sections_of_our_older_files_are_still_read():
    text = "# mapmend: maximum ranges are exact\n" + "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(3))
    text += "#SEQUENTIAL EDGES\nEDGE_SE2 0 1 1 0 0 44 0 0 44 0 44\nEDGE_SE2 0 2 2 0 0 44 0 0 44 0 44\n"
    text += "#LOOP EDGES\nEDGE_SE2 1 2 1 0 0 44 0 0 44 0 44\n"
    assert read(text).is_loop.tolist() == [False, False, True]
