import os

import pytest

from mapmend.errors import OutputError
from mapmend.io.output import check_writable, whole_or_nothing, write_whole


def test_folder_appears_whole(tmp_path):
    target = tmp_path / "new" / "run"
    with whole_or_nothing(target) as folder:
        (folder / "run.json").write_text("{}")
        assert not target.exists()
    assert (target / "run.json").read_text() == "{}"
    assert [p.name for p in target.parent.iterdir()] == ["run"]


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError, SystemExit])
def test_nothing_is_left_after_a_failure(tmp_path, failure):
    def work():
        with whole_or_nothing(tmp_path / "run") as folder:
            (folder / "graph.g2o").write_text("half")
            raise failure

    with pytest.raises(failure):
        work()
    assert list(tmp_path.iterdir()) == []


def test_disk_trouble_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="No space left"), whole_or_nothing(tmp_path / "run"):
        raise OSError(28, "No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_older_run_is_replaced_only_by_a_whole_one(tmp_path):
    target = tmp_path / "run"
    target.mkdir()
    (target / "run.json").write_text("old")
    (target / "extra").write_text("old")
    with pytest.raises(KeyboardInterrupt), whole_or_nothing(target):
        raise KeyboardInterrupt
    assert (target / "run.json").read_text() == "old"
    with whole_or_nothing(target) as folder:
        (folder / "run.json").write_text("new")
    assert sorted(p.name for p in target.iterdir()) == ["run.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_other_folders_and_files_are_refused(tmp_path):
    (tmp_path / "precious").write_text("x")
    for target in (tmp_path, tmp_path / "precious"):
        with pytest.raises(OutputError):
            check_writable(target)
        with pytest.raises(OutputError), whole_or_nothing(target):
            pytest.fail("the work began")
    with pytest.raises(OutputError):
        check_writable(tmp_path / "precious" / "run")
    assert (tmp_path / "precious").read_text() == "x"


def test_empty_folder_is_used(tmp_path):
    (tmp_path / "run").mkdir()
    with whole_or_nothing(tmp_path / "run") as folder:
        (folder / "run.json").write_text("{}")
    assert (tmp_path / "run" / "run.json").exists()


def test_unwritable_parent_is_found_before_the_work(tmp_path):
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
    with pytest.raises(OutputError, match=r"run: can't be written \(Permission denied\); choose a place that can"):
        check_writable(tmp_path / "run")


def test_file_appears_whole(tmp_path):
    write_whole(tmp_path / "a.txt", "one")
    write_whole(tmp_path / "a.txt", b"two")
    assert (tmp_path / "a.txt").read_bytes() == b"two"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    with pytest.raises(OutputError):
        write_whole(tmp_path / "none" / "a.txt", "x")
    with pytest.raises(OutputError, match="directory"):
        write_whole(tmp_path, "x")
