"""A command that is killed at any write or rename leaves its older output or the new one, whole, and all else."""

import io
import json
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from mapmend.cli import main
from mapmend.commands import compare
from mapmend.config import Config
from mapmend.grid.occupancy import occupancy_map
from mapmend.io.carmen_text import write_carmen
from mapmend.io.g2o import write_g2o
from mapmend.io.output import finish_interrupted
from mapmend.run_folder import write_run
from mapmend.simulation import first_scans
from mapmend.slam import MapResult
from mapmend.trajectory import Trajectory
from mapmend.tuning import tune as tuning
from mapmend.view.figures import new_figure, save_figure
from tests.consistency.scenes import room_graph
from tests.io.kills import kill_everywhere, seen
from tests.tuning.graphs import doubtful_room

pytestmark = pytest.mark.slow
NODES = 8
METHODS = ("odometry", "scanmatch")


def room_result():
    """A RUN of eight scans, so small that it is written in milliseconds."""
    graph, config = room_graph(NODES), Config()
    stamps = np.arange(NODES) * 0.5
    occupancy = occupancy_map(graph.scans, graph.poses, config.scan, config.grid)
    counts = {
        "scans": NODES,
        "nodes": NODES,
        "key_nodes": 1,
        "odometry_edges": NODES - 1,
        "loop_edges": 1,
        "optimizations": 1,
    }
    trajectory = Trajectory(stamps, graph.poses)
    return MapResult("go", config, trajectory, graph, occupancy, np.array([0]), counts, 30.0, 25.0, {"match": 1.0})


def command(*arguments):
    """A command that is expected to end with the answer yes or no."""
    assert main([str(argument) for argument in arguments]) in (0, 1)


def warm(words, inputs, folder):
    """Run a command once elsewhere, so that the processes that are killed find modules and kernels loaded."""
    (folder / "warm").mkdir()
    command(*words(inputs, folder / "warm"))


def without_seconds(root):
    """What lies in a folder; of each run.json all but the seconds, which differ in every run."""
    found = seen(root)
    for name, content in found.items():
        if name.endswith("run.json") and content:
            values = json.loads(content)
            values.pop("seconds", None)
            found[name] = values
    return found


@pytest.fixture
def root(tmp_path):
    """A folder for the outputs, and what other people keep in it."""
    (tmp_path / "root").mkdir()
    return tmp_path / "root"


@pytest.fixture
def inputs(tmp_path, simulation, monkeypatch):
    """Input files, and the slow parts of the commands replaced by their results."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    graph, result = room_graph(NODES), room_result()
    write_g2o(folder / "room.g2o", graph)
    write_g2o(folder / "doubtful.g2o", doubtful_room(nodes=40)[0])
    simulation = first_scans(simulation, 20)
    write_carmen(folder / "log.clf", simulation.log)
    write_run(result, folder / "run")
    tuned = tuning.tune(doubtful_room(nodes=40)[0], Config())
    monkeypatch.setattr(tuning, "tune", lambda *_, **__: tuned)
    monkeypatch.setattr("mapmend.simulation.simulate", lambda *_, **__: simulation)
    monkeypatch.setattr("mapmend.slam.build_map", lambda *_, **__: result)
    monkeypatch.setattr(compare, "_run_child", compared)
    for name in ("figures.draw_world", "compare_picture.draw_compared_maps"):
        monkeypatch.setattr(f"mapmend.view.{name}", drawn)
    for name in ("check_picture.check_png", "tune_picture.tune_png"):
        monkeypatch.setattr(f"mapmend.view.{name}", lambda *_: picture())
    return folder


@cache
def picture():
    """A picture as mapmend's are, drawn once: drawing takes longer than everything else."""
    stream = io.BytesIO()
    save_figure(new_figure(1, 1.0, 1.0), stream)
    return stream.getvalue()


def drawn(*arguments):
    next(path for path in arguments if isinstance(path, Path)).write_bytes(picture())


def compared(request, _progress):
    """One method's row, without a process of its own."""
    write_run(room_result(), request["run"])
    row = {"seconds": 1.0, "cpu_seconds": 1.0, "peak_memory_mb": 100.0, "loop_edges": 0, "notes": []}
    return {"method": request["method"], "consistent": True, "p_value": 0.5, **row}


COMMANDS = {
    "map": lambda inputs, out: ("map", inputs / "log.clf", "-o", out / "run"),
    "simulate": lambda _, out: ("simulate", "-o", out / "run", "--scans", 20),
    "compare": lambda inputs, out: ("compare", inputs / "log.clf", "-o", out / "run", "--methods", *METHODS),
    "tune": lambda inputs, out: ("tune", inputs / "doubtful.g2o", "-o", out / "run"),
    "report": lambda inputs, out: ("report", inputs / "run", "-o", out / "report.html"),
    "check": lambda inputs, out: ("check", inputs / "room.g2o", "-o", out),
    "optimize": lambda inputs, out: ("optimize", inputs / "room.g2o", "-o", out / "best.g2o"),
    "convert a graph": lambda inputs, out: ("convert", inputs / "room.g2o", out / "room.toro"),
    "convert a log": lambda inputs, out: ("convert", inputs / "log.clf", out / "copy.clf"),
    "convert to a bag's file": lambda inputs, out: ("convert", inputs / "log.clf", out / "drive.mcap"),
}


@pytest.mark.parametrize("over_old", [False, True])
@pytest.mark.parametrize("name", COMMANDS)
def test_the_older_output_or_the_new(root, tmp_path, inputs, name, over_old):
    words = COMMANDS[name](inputs, root)
    warm(COMMANDS[name], inputs, tmp_path)
    if over_old:
        command(*words)
        older = [path for path in root.rglob("*") if path.is_file() and path.name != "run.json"]
        for path in older:  # so that the older output is another one than the new
            path.write_bytes(path.read_bytes() + b"\n")
        (root / "run" / "deep").mkdir(parents=True, exist_ok=True)
        (root / "run" / "deep" / "notes.txt").write_text("mine")
        (root / "notes.txt").write_text("mine")
    finish = partial(finish_interrupted, root / "run")
    assert kill_everywhere(lambda: command(*words), root, tmp_path, plain=without_seconds, recover=finish) >= 5


@pytest.mark.parametrize("over_old", [False, True])
def test_a_named_graph_and_the_picture_of_its_tuning_are_each_whole(root, tmp_path, inputs, over_old):
    words = ("tune", inputs / "doubtful.g2o", "-o", root / "best.g2o")
    if over_old:
        command(*words)
        (root / "best.g2o").write_text("older")

    def whole(folder):
        """The picture comes first; the graph without it would be left by a kill between the two."""
        return {name: content for name, content in seen(folder).items() if name != "tune.png"}

    assert kill_everywhere(lambda: command(*words), root, tmp_path, plain=whole) >= 5


def test_a_bag_in_a_folder_is_there_or_not(root, tmp_path, inputs):
    words = ("convert", inputs / "log.clf", root / "drive")
    # A bag in a folder never replaces one: where it is there, another command in the folder comes next.
    (root / "notes.txt").write_text("mine")

    def convert():
        if (root / "drive").exists():
            finish_interrupted(root)
        else:
            command(*words)

    assert kill_everywhere(convert, root, tmp_path) >= 5
