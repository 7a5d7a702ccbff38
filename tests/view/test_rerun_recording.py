"""``mapmend view``: rerun's own tool opens its output; what is missing is reported in one line."""

import json
import os
import re
import subprocess
import sys

import pytest

from mapmend.cli import main
from tests.report.conftest import NODES, room_run


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    return room_run(tmp_path_factory.mktemp("view") / "run")[0]


@pytest.fixture(scope="module")
def rerun(tmp_path_factory):
    """rerun's own tool, from its wheel; it is told to report nothing to its makers."""
    pytest.importorskip("rerun", reason="rerun is not installed (the extra view)")
    home = str(tmp_path_factory.mktemp("home"))
    environment = {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home}

    def call(*arguments):
        command = [sys.executable, "-m", "rerun_cli", *map(str, arguments)]
        run = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
        return run.stdout + run.stderr  # its exit code is 0 whatever it finds

    assert "disabled" in call("analytics", "disable")
    return call


def test_the_recording_opens_in_reruns_own_tool(run_folder, rerun, tmp_path, capsys):
    path = tmp_path / "run.rrd"
    assert main(["view", str(run_folder), "--save", str(path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"scans": NODES, "nodes": NODES, "recording": str(path), "bytes": path.stat().st_size}
    assert "1 file verified without error" in rerun("rrd", "verify", path)
    printed = rerun("rrd", "print", path)
    rows = {}
    for count, entity in re.findall(r"with (\d+) rows .*? - (/\S+) - ", printed):
        rows[entity] = max(rows.get(entity, 0), int(count))
    assert rows["/world/robot"] == rows["/world/trajectory"] == rows["/world/scan"] == NODES
    assert rows["/world/nodes"] + rows["/world/key_nodes"] == NODES
    assert rows["/world/key_nodes"] == 4
    assert rows["/world/loops"] == rows["/loops/chi2"] == 2
    assert rows["/world/map"] == 1


def test_a_damaged_recording_does_not_pass_there(run_folder, rerun, tmp_path):
    """The tool that the test above relies on does look."""
    path = tmp_path / "run.rrd"
    assert main(["view", str(run_folder), "--save", str(path)]) == 0
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert "Verification failed" in rerun("rrd", "verify", path)


def complaint(capsys, *arguments):
    assert main(list(map(str, arguments))) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_without_the_extra_one_line_says_what_to_install(run_folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert "pip install 'mapmend[view]'" in complaint(capsys, "view", run_folder, "--save", tmp_path / "run.rrd")
    assert not list(tmp_path.iterdir())


def test_without_a_screen_it_says_what_to_do(run_folder, capsys, monkeypatch):
    pytest.importorskip("rerun", reason="rerun is not installed (the extra view)")
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert "--save run.rrd" in complaint(capsys, "view", run_folder)


def test_what_is_no_run_is_refused(tmp_path, capsys):
    pytest.importorskip("rerun", reason="rerun is not installed (the extra view)")
    assert "trajectory.tum" in complaint(capsys, "view", tmp_path, "--save", tmp_path / "run.rrd")
    assert not list(tmp_path.iterdir())
