"""Outputs appear whole or not at all, and nothing is lost that mapmend did not write."""

import errno
import json
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from mapmend.errors import OutputError
from mapmend.io import swap
from mapmend.io.output import (
    check_file_writable,
    check_own_writable,
    check_writable,
    whole_or_nothing,
    write_whole,
)
from mapmend.io.own_files import own_files
from mapmend.io.staging import Staging


def put(target, text="new", names=("graph.g2o", "map/map.pgm")):
    """Write an output folder of a few files with this text, and its run.json; returns what that says."""
    with whole_or_nothing(target, names) as output:
        for name in names:
            (output.path / name).parent.mkdir(exist_ok=True)
            (output.path / name).write_text(text)
        return output.write_run_json({"mapmend": "1.0", "text": text})


def tree(folder):
    """All below a folder: contents of files, where links lead, None for folders."""
    return {
        path.relative_to(folder).as_posix(): str(path.readlink())
        if path.is_symlink()
        else None
        if path.is_dir()
        else path.read_bytes()
        for path in folder.rglob("*")
    }


def unsupported(*_):
    raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))


@pytest.fixture(params=["exchange", "rename"])
def way(request, monkeypatch):
    """Both ways of putting a folder in place: in one step, and file by file where the system can't exchange names."""
    if request.param == "rename":
        monkeypatch.setattr(swap, "exchange", unsupported)
    return request.param


def test_a_folder_appears_whole(tmp_path):
    target = tmp_path / "new" / "run"
    with whole_or_nothing(target) as output:
        (output.path / "graph.g2o").write_text("graph")
        output.write_run_json({"mapmend": "1.0"})
        assert not target.exists()
    assert json.loads((target / "run.json").read_text()) == {"mapmend": "1.0", "files": ["graph.g2o", "run.json"]}
    assert [p.name for p in target.parent.iterdir()] == ["run"]


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError, SystemExit])
def test_nothing_is_left_after_a_failure(tmp_path, failure):
    def work():
        with whole_or_nothing(tmp_path / "run") as output:
            (output.path / "graph.g2o").write_text("half")
            raise failure

    with pytest.raises(failure):
        work()
    assert list(tmp_path.iterdir()) == []


def test_disk_trouble_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="No space left"), whole_or_nothing(tmp_path / "run"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_an_error_names_the_place_that_was_asked_for(tmp_path):
    def work():
        with whole_or_nothing(tmp_path / "run") as output:
            (output.path / "graph.g2o").symlink_to("/dev/full")
            write_whole(output.path / "graph.g2o", "graph")

    with pytest.raises(OutputError, match=rf"^{tmp_path}/run/graph\.g2o: can't be written \(No space left on device\)"):
        work()
    assert list(tmp_path.iterdir()) == []


def test_a_write_protected_file_of_an_older_run_stays(tmp_path, monkeypatch):
    put(tmp_path / "run", "old")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "graph.g2o" and access(path, mode))
    with pytest.raises(OutputError, match=r"graph\.g2o: is write-protected"):
        put(tmp_path / "run")
    assert (tmp_path / "run" / "graph.g2o").read_text() == "old"


def test_an_older_run_stays_until_the_new_one_is_whole(tmp_path):
    put(tmp_path / "run", "old")
    before = tree(tmp_path)

    def work():
        with whole_or_nothing(tmp_path / "run") as output:
            (output.path / "graph.g2o").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert tree(tmp_path) == before


def test_files_of_mapmend_are_replaced_and_all_others_stay(tmp_path, way):
    run = tmp_path / "run"
    put(run, "old")
    (run / "notes.txt").write_text("mine")
    (run / "map" / "mine.png").write_text("mine")
    (run / "deep" / "empty").mkdir(parents=True)
    (run / "deep" / "log.clf").write_text("log")
    (run / "link").symlink_to("nowhere")
    os.mkfifo(run / "pipe")
    (run / "deep").chmod(0o555)
    run.chmod(0o750)
    inodes = {name: (run / name).lstat().st_ino for name in ("notes.txt", "map/mine.png", "deep/log.clf", "pipe")}
    put(run, "new")
    assert (run / "graph.g2o").read_text() == (run / "map" / "map.pgm").read_text() == "new"
    assert {name: (run / name).lstat().st_ino for name in inodes} == inodes
    assert (run / "notes.txt").read_text() == (run / "map" / "mine.png").read_text() == "mine"
    assert (run / "deep" / "log.clf").read_text() == "log"
    assert (run / "deep" / "empty").is_dir()
    assert str((run / "link").readlink()) == "nowhere"
    assert [stat.S_IMODE(path.stat().st_mode) for path in (run, run / "deep")] == [0o750, 0o555]
    assert json.loads((run / "run.json").read_text())["files"] == ["graph.g2o", "map/map.pgm", "run.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    assert not list(run.glob(".*"))


def test_a_folder_without_a_run_takes_one_beside_what_it_holds(tmp_path, way):
    (tmp_path / "log.clf").write_text("log")
    put(tmp_path)
    assert (tmp_path / "log.clf").read_text() == "log"
    assert (tmp_path / "graph.g2o").read_text() == "new"


@pytest.mark.parametrize("name", ["graph.g2o", "map", "map/map.pgm"])
@pytest.mark.parametrize("kind", ["file", "link"])
def test_a_file_of_somebody_else_is_never_replaced(tmp_path, name, kind):
    run, path = tmp_path / "run", tmp_path / "run" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine") if kind == "file" else path.symlink_to(tmp_path)
    before = tree(tmp_path)

    def unannounced():
        with whole_or_nothing(run) as output:
            (output.path / "map").mkdir()
            for each in ("graph.g2o", "map/map.pgm"):
                (output.path / each).write_text("new")

    for attempt in (lambda: check_writable(run, ["graph.g2o", "map/map.pgm"]), lambda: put(run), unannounced):
        with pytest.raises(OutputError, match=rf"{name}: is (a link;|there, and run\.json does not list it)"):
            attempt()
    assert tree(tmp_path) == before


def test_a_listed_file_that_has_become_a_link_is_somebody_elses(tmp_path):
    put(tmp_path / "run", "old")
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "run" / "graph.g2o").unlink()
    (tmp_path / "run" / "graph.g2o").symlink_to(tmp_path / "precious")
    with pytest.raises(OutputError, match=r"graph\.g2o: is a link; name another folder, or remove the link"):
        put(tmp_path / "run")
    assert (tmp_path / "precious").read_text() == "mine"


@pytest.mark.parametrize(
    "page",
    [
        "{}", "", "[]", "null", "{", '"mapmend"', '{"mapmend": 1}', '{"mapmend": "1.0"}', '{"mapmend": "", "files": 3}',
        '{"mapmend": "1.0", "files": ["../thesis.tex"]}', '{"mapmend": "1.0", "files": ["/etc/passwd"]}',
        '{"mapmend": "1.0", "files": [1]}', '{"files": ["run.json"]}', "[" * 100_000,
    ],
)  # fmt: skip
def test_a_run_json_that_is_not_ours_is_refused_and_stays(tmp_path, page):
    (tmp_path / "run.json").write_text(page)
    (tmp_path / "thesis.tex").write_text("x")
    before = tree(tmp_path)
    with pytest.raises(OutputError, match=r"holds a run\.json that is not mapmend's"):
        check_writable(tmp_path)
    with pytest.raises(OutputError, match="not mapmend's"):
        put(tmp_path)
    assert tree(tmp_path) == before


RUN = {"trajectory.tum", "graph.g2o", "map.pgm", "map.yaml", "map.png", "run.json"}
OLD_RUN_JSONS = [
    ({"method": "igo", "seed": 0, "counts": {}, "chi2_final": 0.0}, RUN),
    ({"world": "corridor", "seed": 0, "scans": 5, "path_m": 1.0}, {"log.clf", "truth.tum", "world.png", "run.json"}),
    ({"log": "a", "methods": [{"method": "go"}]}, {f"go/{n}" for n in RUN} | {"compare.png", "run.json"}),
    (
        {"world": "corridor", "methods": [{"method": "go"}]},
        {f"go/{n}" for n in RUN} | {"demo.png", "log.clf", "truth.tum", "world.png", "run.json"},
    ),
]


@pytest.mark.parametrize(("page", "names"), OLD_RUN_JSONS)
def test_a_run_json_of_version_0_1_0_tells_its_files(tmp_path, page, names):
    (tmp_path / "run.json").write_text(json.dumps({"mapmend": "0.1.0", **page}))
    assert own_files(tmp_path) == names


def test_an_older_output_of_another_command_stays_listed(tmp_path):
    put(tmp_path, "old", ["log.clf"])
    page = put(tmp_path, "new", ["graph.g2o"])
    assert page["files"] == ["graph.g2o", "log.clf", "run.json"]
    assert "older_files" not in page  # the log does not depend on what was replaced
    assert put(tmp_path, "newer", ["log.clf"])["older_files"].keys() == {"graph.g2o"}
    assert (tmp_path / "graph.g2o").read_text() == "new"


def test_what_was_made_of_the_older_run_is_named_until_it_is_made_again(tmp_path):
    put(tmp_path, "old")
    (tmp_path / "report.html").write_text("of the old one")
    assert put(tmp_path)["older_files"].keys() == {"report.html"}
    (tmp_path / "report.html").unlink()
    assert "older_files" not in put(tmp_path)


def test_a_folder_that_is_a_link_is_followed(tmp_path, way):
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk" / "run")
    for text in ("old", "new"):
        put(tmp_path / "run", text)
        assert (tmp_path / "run").is_symlink()
        assert (tmp_path / "disk" / "run" / "graph.g2o").read_text() == text


def test_the_working_directory_stays_the_one_that_is_written(tmp_path, monkeypatch):
    put(tmp_path / "run", "old")
    monkeypatch.chdir(tmp_path / "run")
    put(".")
    assert Path("graph.g2o").read_text() == (tmp_path / "run" / "graph.g2o").read_text() == "new"
    assert not [name for name in os.listdir() if name.startswith(".")]


def test_a_file_that_comes_while_the_folders_change_places_is_not_lost(tmp_path, monkeypatch):
    put(tmp_path / "run", "old")
    (tmp_path / "run" / "notes.txt").write_text("first")
    exchange = swap.exchange

    def slow(one, other):
        (other / "late.txt").write_text("late")
        (other / "edited").write_text("second")
        os.replace(other / "edited", other / "notes.txt")
        exchange(one, other)

    monkeypatch.setattr(swap, "exchange", slow)
    put(tmp_path / "run")
    assert (tmp_path / "run" / "late.txt").read_text() == "late"
    assert (tmp_path / "run" / "notes.txt").read_text() == "second"
    assert (tmp_path / "run" / "graph.g2o").read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_what_can_not_take_a_folder_is_refused(tmp_path):
    (tmp_path / "precious").write_text("x")
    for target in (tmp_path / "precious", tmp_path / "precious" / "run"):
        with pytest.raises(OutputError):
            check_writable(target)
        with pytest.raises(OutputError):
            put(target)
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(OutputError):
        check_writable(tmp_path / "loop")
    with pytest.raises(OutputError):
        write_whole(tmp_path / "loop", "x")
    assert (tmp_path / "precious").read_text() == "x"


def test_an_empty_folder_is_used(tmp_path, way):
    (tmp_path / "run").mkdir(0o700)
    put(tmp_path / "run")
    assert (tmp_path / "run" / "run.json").exists()
    assert stat.S_IMODE((tmp_path / "run").stat().st_mode) == 0o700


def test_an_unwritable_parent_is_found_before_the_work(tmp_path):
    tmp_path.chmod(0o500)
    try:
        if os.access(tmp_path, os.W_OK):
            pytest.skip("this user may write everywhere")
        with pytest.raises(OutputError):
            check_writable(tmp_path / "run")
    finally:
        tmp_path.chmod(0o700)


def test_refused_permission_is_one_clear_line(tmp_path, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("mapmend.io.output.tempfile.TemporaryFile", refuse)
    for check in (check_writable, check_file_writable, check_own_writable):
        with pytest.raises(OutputError, match=r"run: can't be written \(Permission denied\); choose a place that can"):
            check(tmp_path / "run")


def test_where_nothing_can_be_made_beside_the_folder_it_is_made_within(tmp_path, monkeypatch):
    put(tmp_path / "run", "old")
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path and access(path, mode))
    (tmp_path / "run" / "notes.txt").write_text("mine")
    put(tmp_path / "run")
    assert tree(tmp_path / "run").keys() == {"graph.g2o", "map", "map/map.pgm", "notes.txt", "run.json"}
    assert (tmp_path / "run" / "graph.g2o").read_text() == "new"


def test_where_another_file_system_begins_the_files_are_copied_into_it(tmp_path, monkeypatch):
    put(tmp_path / "run", "old")
    rename = os.rename

    def across(one, other):
        if ".run.mapmend-" in Path(one).name and Path(other).parent == tmp_path / "run":
            raise OSError(errno.EXDEV, os.strerror(errno.EXDEV))
        rename(one, other)

    monkeypatch.setattr(swap, "exchange", unsupported)
    monkeypatch.setattr(os, "rename", across)
    put(tmp_path / "run")
    assert (tmp_path / "run" / "map" / "map.pgm").read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["run"]
    assert not list((tmp_path / "run").glob(".*"))


SLEEPER = """
import sys, time
from pathlib import Path
from mapmend.io.output import whole_or_nothing
from mapmend.io.staging import hidden_file
target = Path(sys.argv[1])
with whole_or_nothing(target) as output, hidden_file(target.parent, "graph.g2o"):
    (output.path / "graph.g2o").write_text("half")
    print("ready", flush=True)
    time.sleep(100)
"""


def test_what_a_killed_run_left_is_swept_and_what_a_living_one_makes_is_not(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(swap.__file__).parents[2])}
    command = [sys.executable, "-c", SLEEPER, str(tmp_path / "run")]
    (tmp_path / ".run.mine").mkdir()
    (tmp_path / ".run.mapmend-notes").write_text("mine")
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as sleeper:
        try:
            assert sleeper.stdout.readline() == "ready\n"
            left = {p.name for p in tmp_path.iterdir()}
            assert len(left) == 4
            put(tmp_path / "other")
            write_whole(tmp_path / "file", "x")
            assert {p.name for p in tmp_path.iterdir()} == left | {"other", "file"}
        finally:
            sleeper.kill()
    put(tmp_path / "run")
    assert {p.name for p in tmp_path.iterdir()} == {".run.mine", ".run.mapmend-notes", "other", "file", "run"}


def test_a_child_that_outlives_its_parent_does_not_make_a_swept_folder_again(tmp_path):
    staging = Staging(tmp_path, "compare")
    swap.close(staging)  # as the next run does when the parent is dead
    with pytest.raises(OutputError, match="No such file or directory"):
        put(staging.new / "igo")
    assert list(tmp_path.iterdir()) == []


def test_a_child_process_that_was_killed_leaves_nothing_in_the_output(tmp_path):
    with whole_or_nothing(tmp_path / "run") as output:
        Staging(output.path, "igo").release()
        (output.path / ".a.mapmend-00000000").write_text("half")
        assert output.write_run_json({"mapmend": "1.0"})["files"] == ["run.json"]
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["run.json"]
