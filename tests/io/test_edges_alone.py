"""Graphs whose files give no poses, or not all: the nodes are laid along the edges."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.geometry import se2
from mapmend.graph.optimizer import edge_chi2, optimize
from mapmend.graph.pose_graph import PoseGraph
from mapmend.graph.starts import along_odometry
from mapmend.io.g2o import read_g2o, write_g2o
from mapmend.io.graph_lines import parse_graph
from mapmend.io.info import describe_content
from mapmend.io.toro import write_toro
from tests.graph.graphs import consistent, random_graph
from tests.io.samples import short_graph
from tests.real_data import data_path

several = settings(max_examples=25, deadline=None)
EDGE = "1 0 0 1 0 1"


def text_without(graph: PoseGraph, ids, write=write_g2o) -> bytes:
    """The graph's file without the vertices of those ids, the marks at its end left out."""
    stream = io.StringIO()
    write(stream, graph)
    left_out = {str(one) for one in ids}
    lines = [line for line in stream.getvalue().splitlines() if not line.startswith("#")]
    return "\n".join(line for line in lines if not (line.startswith("VERTEX") and line.split()[1] in left_out)).encode()


def assert_same_poses(got, expected):
    difference = got - expected
    difference[:, 2] = se2.wrap_angle(difference[:, 2])
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)


def shuffled(graph: PoseGraph, seed: int) -> PoseGraph:
    """The same graph, its edges in another order, every second measured from its other end."""
    order = np.random.default_rng(seed).permutation(len(graph.edges))
    edges, measurements = graph.edges[order], graph.measurements[order]
    edges[::2] = edges[::2, ::-1]
    measurements[::2] = se2.inverse(measurements[::2])
    return replace(
        graph,
        edges=edges,
        measurements=measurements,
        information=graph.information[order],
        is_loop=graph.is_loop[order],
    )


@several
@given(st.integers(0, 10_000), st.sampled_from([write_g2o, write_toro]))
def test_of_edges_without_noise_all_poses_are_found(seed, write):
    truth = shuffled(consistent(random_graph(seed)), seed)
    graph = parse_graph(text_without(truth, truth.ids, write), "graph")
    np.testing.assert_array_equal(graph.ids, truth.ids)
    np.testing.assert_array_equal(graph.edges, truth.edges)
    assert graph.fixed == (0,)
    assert_same_poses(graph.poses, se2.between(truth.poses[0], truth.poses))
    assert [str(note) for note in graph.notes] == [
        "the file gives no poses of the nodes: they were laid along the edges"
    ]


@several
@given(st.integers(0, 10_000), st.sets(st.integers(0, 11), min_size=1, max_size=11))
def test_some_vertices_are_laid_from_those_that_the_file_gives(seed, missing):
    truth = shuffled(consistent(random_graph(seed)), seed)
    rows = sorted(missing)
    graph = parse_graph(text_without(truth, truth.ids[rows]), "graph")
    np.testing.assert_array_equal(graph.ids, truth.ids)
    assert_same_poses(graph.poses, truth.poses)
    kept = np.setdiff1d(np.arange(len(truth)), rows)
    np.testing.assert_array_equal(graph.poses[kept], truth.poses[kept])
    (note,) = map(str, graph.notes)
    assert f"no poses of {len(rows)} of 12 nodes ({truth.ids[rows[0]]}" in note


def test_odometry_is_followed_before_any_loop():
    """The loops are so certain that the tree of the best edges would take them, and they contradict the odometry."""
    graph = random_graph(3)
    graph = graph.with_edges(~graph.is_loop | (np.abs(np.diff(graph.edges, axis=1)[:, 0]) > 1))
    information = np.where(graph.is_loop[:, None, None], 1e6 * graph.information, graph.information)
    measurements = np.where(graph.is_loop[:, None], graph.measurements + 1.0, graph.measurements)
    graph = shuffled(replace(graph, information=information, measurements=measurements), 3)
    read = parse_graph(text_without(graph, graph.ids), "graph")
    start = replace(graph, poses=np.zeros_like(graph.poses))
    assert_same_poses(read.poses, along_odometry(start))


def test_loops_are_followed_where_the_odometry_is_broken():
    lines = [f"EDGE_SE2 0 1 1 0 0 {EDGE}", f"EDGE_SE2 5 6 1 0 0 {EDGE}", f"EDGE_SE2 1 6 0 3 0.5 {EDGE}"]
    graph = parse_graph("\n".join(lines).encode(), "graph")
    assert graph.ids.tolist() == [0, 1, 5, 6]
    expected = [[0, 0, 0], [1, 0, 0], [1 - np.cos(0.5), 3 - np.sin(0.5), 0.5], [1, 3, 0.5]]
    np.testing.assert_allclose(graph.poses, expected, atol=1e-12)


def test_vertices_in_no_order_stay_where_they_stand():
    text = f"VERTEX_SE2 7 5 5 0\nVERTEX_SE2 2 0 0 0\nEDGE_SE2 7 3 1 0 0 {EDGE}\nEDGE_SE2 2 1 1 0 0 {EDGE}\n"
    graph = parse_graph(text.encode(), "graph")
    assert graph.ids.tolist() == [7, 2, 1, 3]
    assert graph.poses.tolist() == [[5, 5, 0], [0, 0, 0], [1, 0, 0], [6, 5, 0]]


def test_each_part_begins_at_the_origin_with_its_fixed_node_or_its_first():
    lines = [f"EDGE_SE2 {i} {i + 1} 1 0 0 {EDGE}" for i in (0, 1, 10, 11)]
    graph = parse_graph("\n".join([*lines, "FIX 0 11"]).encode(), "graph")
    assert graph.poses[:, 0].tolist() == [0, 1, 2, -1, 0, 1]
    assert graph.fixed == (0, 4)
    notes = describe_content(graph).notes
    assert any("laid along the edges" in note for note in notes)
    assert "the graph is not connected" in notes


def test_scans_stay_with_their_nodes():
    whole = parse_graph(short_graph().encode(), "graph")
    lines = short_graph().splitlines()
    del lines[2:4]  # vertex 1 and its scan
    graph = parse_graph("\n".join(lines).encode(), "graph")
    assert graph.ids.tolist() == [0, 1, 2, 3]
    assert np.diff(graph.scans.offsets).tolist() == [3, 0, 3, 3]
    np.testing.assert_array_equal(graph.stamps_s[[0, 2, 3]], whole.stamps_s[[0, 2, 3]])
    assert np.isnan(graph.stamps_s[1])


def test_a_graph_with_all_its_vertices_has_no_note():
    assert parse_graph(short_graph().encode(), "graph").notes == ()


def test_a_public_graph_without_its_vertices_is_optimized_to_the_same_optimum():
    graph = read_g2o(data_path("posegraphs/intel.g2o.gz"))
    laid = parse_graph(text_without(graph, graph.ids), "graph")
    assert edge_chi2(laid)[~graph.is_loop].sum() < 1e-6
    assert optimize(laid).chi2_final == pytest.approx(optimize(graph).chi2_final, rel=1e-6)


def test_commands_say_that_poses_were_laid(mapmend, tmp_path):
    graph = random_graph(5)
    path = tmp_path / "edges.g2o"
    path.write_bytes(text_without(graph, graph.ids))
    said = "the file gives no poses of the nodes: they were laid along the edges"
    assert said in mapmend("info", path).out
    assert said in json.loads(mapmend("info", path, "--json").out)["notes"][0]
    optimized = mapmend("optimize", path, "-o", tmp_path / "out.g2o")
    assert optimized.code == 0
    assert said in optimized.complaint
    assert said in mapmend("convert", path, tmp_path / "out.toro").complaint
    assert "VERTEX2 7 0.0 0.0 0.0" in (tmp_path / "out.toro").read_text()
    edges = tmp_path / "parts.g2o"
    edges.write_text(f"EDGE_SE2 0 1 1 0 0 {EDGE}\nEDGE_SE2 5 6 1 0 0 {EDGE}\n")
    answer = mapmend("optimize", edges, "-o", tmp_path / "parts-out.g2o")
    assert (answer.code, (tmp_path / "parts-out.g2o").exists()) == (2, False)
    assert "no chain of edges joins node 5 to a fixed node" in answer.complaint
