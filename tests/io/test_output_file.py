"""Single files: whole or not at all, links followed, devices and pipes written to, and no input destroyed."""

import os
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mapmend.errors import OutputError
from mapmend.io import swap
from mapmend.io.output import check_file_writable, check_own_writable, write_own, write_whole
from tests.io.test_output import put


def test_a_file_appears_whole(tmp_path):
    write_whole(tmp_path / "a.txt", "one")
    write_whole(tmp_path / "a.txt", b"two")
    assert (tmp_path / "a.txt").read_bytes() == b"two"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    with pytest.raises(OutputError):
        write_whole(tmp_path / "none" / "a.txt", "x")
    with pytest.raises(OutputError, match="directory"):
        write_whole(tmp_path, "x")


def test_a_file_that_is_a_link_is_followed_and_keeps_its_permissions(tmp_path):
    (tmp_path / "secret").write_text("old")
    (tmp_path / "secret").chmod(0o600)
    (tmp_path / "link").symlink_to("secret")
    (tmp_path / "dangling").symlink_to("made")
    for name, target in (("link", "secret"), ("dangling", "made")):
        check_file_writable(tmp_path / name)
        write_whole(tmp_path / name, "new")
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / target).read_text() == "new"
    assert stat.S_IMODE((tmp_path / "secret").stat().st_mode) == 0o600


def test_devices_and_pipes_are_written_to_and_stay(tmp_path):
    device = os.stat(os.devnull)
    check_file_writable(os.devnull)
    write_whole(os.devnull, "x" * 10_000_000)
    assert os.stat(os.devnull).st_rdev == device.st_rdev
    with pytest.raises(OutputError, match=r"/dev/full: can't be written \(No space left on device\)"):
        write_whole("/dev/full", "x")
    os.mkfifo(tmp_path / "pipe")
    came = []
    reader = threading.Thread(target=lambda: came.append((tmp_path / "pipe").read_text()))
    reader.start()
    check_file_writable(tmp_path / "pipe")
    write_whole(tmp_path / "pipe", "through")
    reader.join()
    assert came == ["through"]
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.parametrize("name", ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1", "link"])
@pytest.mark.parametrize("to_file", [True, False])
def test_standard_output_takes_its_turn_whatever_it_leads_to(tmp_path, name, to_file):
    (tmp_path / "link").symlink_to("/dev/stdout")
    script = f"from mapmend.io.output import *; print('1'); write_whole({name!r}, '2\\n'); print('3')"
    environment = {**os.environ, "PYTHONPATH": str(Path(swap.__file__).parents[2])}
    command = [sys.executable, "-c", script]
    if to_file:
        with (tmp_path / "out").open("w") as out:
            subprocess.run(command, stdout=out, check=True, cwd=tmp_path, env=environment)
        printed = (tmp_path / "out").read_text()
    else:
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path, env=environment)
        printed = done.stdout
    assert printed == "1\n2\n3\n"


def test_a_file_whose_name_mapmend_chose_replaces_only_its_own(tmp_path):
    (tmp_path / "report.html").write_text("<html>mine</html>")
    with pytest.raises(OutputError, match="is there, and not by mapmend"):
        check_own_writable(tmp_path / "report.html")
    with pytest.raises(OutputError, match="is there, and not by mapmend"):
        write_own(tmp_path / "report.html", "x")
    assert (tmp_path / "report.html").read_text() == "<html>mine</html>"
    for text in ("first", "second"):
        write_own(tmp_path / "new" / "report.html", f'<meta name="generator" content="mapmend 0.1.0">{text}')
    assert (tmp_path / "new" / "report.html").read_text().endswith("second")
    (tmp_path / "link.html").symlink_to("new/report.html")
    write_own(tmp_path / "link.html", "third")
    assert (tmp_path / "link.html").is_symlink()
    assert (tmp_path / "new" / "report.html").read_text() == "third"
    with pytest.raises(OutputError, match="is there, and not by mapmend"):
        write_own(tmp_path / "link.html", "fourth")


def test_an_output_that_is_the_input_is_refused(tmp_path):
    (tmp_path / "a.g2o").write_text("graph")
    (tmp_path / "link.g2o").symlink_to("a.g2o")
    os.link(tmp_path / "a.g2o", tmp_path / "hard.g2o")
    for name in ("a.g2o", "link.g2o", "hard.g2o"):
        with pytest.raises(OutputError, match="is the input; name another file"):
            check_file_writable(tmp_path / name, [tmp_path / "a.g2o"])
    put(tmp_path / "run", names=["graph.g2o"])
    with pytest.raises(OutputError, match="is the input"):
        check_file_writable(tmp_path / "run" / "graph.g2o", [tmp_path / "run"])
    check_file_writable(tmp_path / "run" / "report.html", [tmp_path / "run"])
    check_file_writable(tmp_path / "b.g2o", [tmp_path / "a.g2o"])


def test_a_write_protected_file_stays(tmp_path, monkeypatch):
    (tmp_path / "a.g2o").write_text("keep")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(OutputError, match=r"a\.g2o: is write-protected; choose another place, or allow writing"):
        check_file_writable(tmp_path / "a.g2o")
