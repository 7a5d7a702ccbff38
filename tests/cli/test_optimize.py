"""``mapmend optimize``: what it prints, writes and refuses."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mapmend.commands.common import options
from mapmend.graph.optimizer import edge_chi2, optimize
from mapmend.graph.robust import KERNELS
from mapmend.graph.starts import STARTS
from mapmend.io.g2o import read_g2o, write_g2o
from mapmend.io.toro import read_toro, write_toro
from mapmend.lab.false_loops import add_false_loops
from mapmend.scan import LaserGeometry, Scans
from tests.cli.interrupts import interrupted
from tests.graph.graphs import perturbed, random_graph


@pytest.fixture
def graph():
    return perturbed(random_graph(2, nodes=40, loops=30), 2, 0.02)


@pytest.fixture
def path(graph, tmp_path):
    write_g2o(tmp_path / "in.g2o", graph)
    return tmp_path / "in.g2o"


def with_scans(graph):
    generator = np.random.default_rng(0)
    ranges = generator.uniform(1.0, 5.0, size=5 * len(graph)).round(2).astype(np.float32)
    geometry = LaserGeometry(5, -1.0, 0.5, 30.0)
    scans = Scans(ranges, 5 * np.arange(len(graph) + 1), np.zeros(len(graph), np.int32), (geometry,))
    return replace(graph, scans=scans, stamps_s=100.0 + np.arange(len(graph)))


def test_the_optimum_is_written_and_said(mapmend, graph, path, tmp_path):
    values = json.loads(mapmend("optimize", path, "-o", tmp_path / "out.g2o", "--json").out)
    expected, written = optimize(graph), read_g2o(tmp_path / "out.g2o")
    np.testing.assert_allclose(written.poses, expected.poses, atol=1e-12)
    np.testing.assert_array_equal(written.measurements, graph.measurements)
    np.testing.assert_array_equal(written.is_loop, graph.is_loop)
    assert values["chi2_initial"] == pytest.approx(edge_chi2(graph).sum())
    assert values["chi2_final"] == pytest.approx(expected.chi2_final)
    assert values["iterations"] == expected.iterations
    assert {"read", "analyse", "solve", "write"} <= set(values["seconds"])
    assert values["distrusted"] == []
    text = mapmend("optimize", path, "-o", tmp_path / "out.g2o").out
    assert f"chi2: {values['chi2_initial']:.3f} before, {values['chi2_final']:.3f} after" in text
    assert "seconds" in text
    assert "distrusts" not in text


@pytest.mark.parametrize("name", ["out.toro", "out.graph", "out.g2o", "out"])
def test_the_suffix_decides_the_format(mapmend, graph, tmp_path, name):
    write_toro(tmp_path / "in.graph", graph)
    assert mapmend("optimize", tmp_path / "in.graph", "-o", tmp_path / name).code == 0
    text = (tmp_path / name).read_text()
    assert ("VERTEX_SE2" in text) == name.endswith(".g2o")
    np.testing.assert_allclose(read_toro(tmp_path / name).poses, optimize(graph).poses, atol=1e-12)


def test_scans_and_stamps_travel_along(mapmend, graph, tmp_path):
    carrying = with_scans(graph)
    write_g2o(tmp_path / "in.g2o", carrying)
    assert mapmend("optimize", tmp_path / "in.g2o", "-o", tmp_path / "out.g2o").code == 0
    written = read_g2o(tmp_path / "out.g2o")
    np.testing.assert_array_equal(written.scans.ranges_m, carrying.scans.ranges_m)
    np.testing.assert_array_equal(written.stamps_s, carrying.stamps_s)


@pytest.mark.parametrize("kernel", KERNELS)
def test_distrusted_loops_are_named(mapmend, graph, tmp_path, kernel):
    spoiled = add_false_loops(graph, "random", 3, seed=4).graph
    write_g2o(tmp_path / "in.g2o", spoiled)
    arguments = ("optimize", tmp_path / "in.g2o", "-o", tmp_path / "out.g2o", "--kernel", kernel, "--phi", 1)
    values = json.loads(mapmend(*arguments, "--json").out)
    assert (values["kernel"], values["phi"]) == (kernel, 1.0)
    rows = [one["edge"] for one in values["distrusted"]]
    assert rows
    ids = spoiled.ids[spoiled.edges[rows]].tolist()
    assert ids == [[one["from"], one["to"]] for one in values["distrusted"]]
    text = mapmend(*arguments).out
    assert f"distrusts {len(rows)} edges" in text
    worst = min(values["distrusted"], key=lambda one: (one["weight"], -one["chi2"]))
    i, j = worst["from"], worst["to"]
    assert f"{i} -> {j}" in text


@pytest.mark.parametrize("init", STARTS)
def test_every_start_ends_in_the_same_optimum(mapmend, graph, path, tmp_path, init):
    arguments = ("optimize", path, "-o", tmp_path / "out.g2o", "--init", init)
    values = json.loads(mapmend(*arguments, "--json").out)
    assert values["init"] == init
    assert values["chi2_initial"] == pytest.approx(edge_chi2(graph).sum())
    assert values["chi2_final"] == pytest.approx(optimize(graph).chi2_final)
    assert (f"start: {init}, chi2 {values['chi2_start']:.3f}" in mapmend(*arguments).out) == (init != "given")


def test_no_start_along_odometry_that_is_not_there(mapmend, graph, path, tmp_path):
    kept = np.arange(len(graph.edges)) != 5
    torn = replace(
        graph,
        edges=graph.edges[kept],
        measurements=graph.measurements[kept],
        information=graph.information[kept],
        is_loop=graph.is_loop[kept],
    )
    write_g2o(path, torn)
    answer = mapmend("optimize", path, "-o", tmp_path / "out.g2o", "--init", "odometry")
    assert answer.code == 2
    assert "no edge joins node 57 to the next, 67" in answer.complaint
    assert not (tmp_path / "out.g2o").exists()
    assert mapmend("optimize", path, "-o", tmp_path / "out.g2o", "--init", "tree").code == 0


def test_all_edges_may_be_doubted(mapmend, graph, path, tmp_path):
    wrong = graph.measurements.copy()
    wrong[20, :2] += 3.0
    write_g2o(path, replace(graph, measurements=wrong))
    arguments = ("optimize", path, "-o", tmp_path / "out.g2o", "--kernel", "dcs", "--json")
    assert 20 not in [one["edge"] for one in json.loads(mapmend(*arguments).out)["distrusted"]]
    assert 20 in [one["edge"] for one in json.loads(mapmend(*arguments, "--all-edges").out)["distrusted"]]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["--kernel", "tukey"], "invalid choice: 'tukey'"),
        (["--phi", "0"], "'0' is not a number above 0"),
        (["--phi", "nan"], "'nan' is not a number above 0"),
        (["--phi", "2"], "--phi and --all-edges say how a kernel doubts"),
        (["--all-edges"], "--phi and --all-edges say how a kernel doubts"),
        (["--init", "luck"], "invalid choice: 'luck'"),
    ],
)
def test_wrong_arguments(mapmend, path, tmp_path, arguments, what):
    answer = mapmend("optimize", path, "-o", tmp_path / "out.g2o", *arguments)
    assert answer.code == 2
    assert what in answer.complaint
    assert not (tmp_path / "out.g2o").exists()


def test_files_that_cannot_be_used(mapmend, path, tmp_path, log_path):
    out = tmp_path / "out.g2o"
    assert "holds no pose graph" in mapmend("optimize", log_path, "-o", out).complaint
    assert "no such file" in mapmend("optimize", tmp_path / "none.g2o", "-o", out).complaint
    assert "can't be written" in mapmend("optimize", path, "-o", tmp_path / "no" / "out.g2o").complaint
    assert "name it without .gz" in mapmend("optimize", path, "-o", tmp_path / "out.g2o.gz").complaint
    assert "is a directory" in mapmend("optimize", path, "-o", tmp_path).complaint
    lines = path.read_text().splitlines()
    fewer = [line for line in lines if not line.startswith("EDGE") or line.split()[1] == "7"]
    path.write_text("\n".join(fewer))
    assert "edges were added or taken out" in mapmend("optimize", path, "-o", out).complaint
    path.write_text("\n".join(line for line in fewer if not line.startswith("#")))
    assert "no chain of edges joins node" in mapmend("optimize", path, "-o", out).complaint
    assert not out.exists()


def test_ctrl_c_in_the_middle_leaves_nothing(path, tmp_path):
    done = interrupted("optimize", "optimize", path, "-o", tmp_path / "out.g2o", "--kernel", "gnc")
    assert done.returncode == 130
    lines = [line for line in done.stderr.splitlines() if "compiling kernels" not in line]
    assert lines == ["mapmend: interrupted; nothing was written"]
    assert [p.name for p in tmp_path.iterdir()] == ["in.g2o"]


def test_the_command_line_knows_kernels_and_starts():
    assert list(options.KERNELS) == list(KERNELS)
    assert list(options.STARTS) == list(STARTS)
