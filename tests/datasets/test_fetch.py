"""Public logs from a server on this machine: complete, resumed after an interruption, never with other content."""

import bz2
import hashlib
import json
import os
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from mapmend.datasets import fetch as fetching
from mapmend.datasets import registry
from mapmend.datasets.cache import cache_folder, fetched_path, named_file
from mapmend.datasets.fetch import fetch
from mapmend.datasets.registry import Dataset, RemoteFile
from mapmend.errors import InputError, MapmendError, OutputError
from mapmend.io.carmen import write_carmen
from mapmend.io.reader import read
from mapmend.scan import ScanLog
from mapmend.simulation import corridor_loop, first_scans, simulate
from tests.real_data import data_path


class Server(ThreadingHTTPServer):
    """Serves ``contents`` by name; ``cuts`` are the numbers of bytes after which the next answers break off."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.contents, self.cuts, self.asked, self.knows_ranges = {}, [], [], True
        self.url = f"http://127.0.0.1:{self.server_address[1]}/"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        content = self.server.contents.get(self.path.lstrip("/"))
        asked = self.headers.get("Range")
        self.server.asked.append(asked)
        if content is None:
            return self.send_error(404)
        begin = int(asked.removeprefix("bytes=").rstrip("-")) if asked and self.server.knows_ranges else 0
        if begin >= len(content):
            return self.send_error(416)
        self.send_response(206 if begin else 200)
        self.send_header("Content-Length", str(len(content) - begin))
        self.end_headers()
        cut = self.server.cuts.pop(0) if self.server.cuts else len(content)
        self.wfile.write(content[begin : begin + cut])
        return None

    def log_message(self, *_):
        """Quiet."""


@pytest.fixture
def server():
    server = Server()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


@pytest.fixture
def content(tmp_path):
    """A packed log of its own."""
    write_carmen(tmp_path / "drive.clf", first_scans(simulate(corridor_loop(), seed=1), 20).log)
    return bz2.compress((tmp_path / "drive.clf").read_bytes())


@pytest.fixture
def dataset(server, content, monkeypatch, tmp_path):
    """The only dataset there is: one file on the server, and an empty cache."""
    monkeypatch.setenv("MAPMEND_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(fetching, "_PAUSE_S", 0.01)
    server.contents["drive.clf.bz2"] = content
    file = RemoteFile("drive.clf.bz2", server.url + "drive.clf.bz2", hashlib.sha256(content).hexdigest())
    dataset = Dataset("drive", "a drive", (file,), "CC-BY 3.0", "Somebody: A drive. 2026")
    monkeypatch.setattr(registry, "DATASETS", (dataset,))
    monkeypatch.setattr("mapmend.commands.datasets.DATASETS", (dataset,))
    return dataset


def test_a_name_stands_for_the_fetched_log(dataset, content, server):
    with pytest.raises(InputError, match="fetch it with: mapmend datasets fetch drive"):
        named_file("drive")
    paths = fetch(dataset)
    assert paths == [cache_folder() / "drive.clf.bz2"]
    assert paths[0].read_bytes() == content
    assert isinstance(read(named_file("drive")), ScanLog)
    assert isinstance(read(named_file("drive.clf.bz2")), ScanLog)
    fetch(dataset)
    assert len(server.asked) == 1  # what is there is not fetched again
    assert [path.name for path in cache_folder().iterdir()] == ["drive.clf.bz2"]


def test_a_broken_transfer_is_taken_up_where_it_broke_off(dataset, content, server):
    server.cuts = [1000, 500]
    assert fetch(dataset)[0].read_bytes() == content
    assert server.asked == [None, "bytes=1000-", "bytes=1500-"]


def test_what_came_is_kept_for_the_next_try(dataset, content, server):
    server.cuts = [1000, 0, 0, 0]
    with pytest.raises(MapmendError, match=r"drive.clf.bz2: can't be fetched.*check the network"):
        fetch(dataset)
    assert not (cache_folder() / "drive.clf.bz2").exists()
    assert (cache_folder() / "drive.clf.bz2.part").stat().st_size == 1000
    assert fetch(dataset)[0].read_bytes() == content
    assert server.asked[-1] == "bytes=1000-"
    assert not (cache_folder() / "drive.clf.bz2.part").exists()


def test_a_server_without_ranges_sends_it_all_again(dataset, content, server):
    server.knows_ranges = False
    server.cuts = [1000]
    assert fetch(dataset)[0].read_bytes() == content


def test_another_content_is_refused_and_not_kept(dataset, content, server):
    server.contents["drive.clf.bz2"] = content[:-1] + b"x"
    with pytest.raises(MapmendError, match="its sha256 differs"):
        fetch(dataset)
    assert list(cache_folder().iterdir()) == []
    server.contents["drive.clf.bz2"] = content
    assert fetch(dataset)[0].read_bytes() == content


def test_a_damaged_file_in_the_cache_is_not_read_but_fetched_again(dataset, content):
    path = fetch(dataset)[0]
    path.write_bytes(content[:-1])
    with pytest.raises(InputError, match="does not have the expected content; fetch it with"):
        fetched_path("drive")
    assert fetch(dataset)[0].read_bytes() == content


def test_without_network_it_says_what_can_be_done(dataset, server, content):
    server.shutdown()
    server.server_close()
    with pytest.raises(MapmendError, match=r"check the network, or put the file into .*cache yourself") as caught:
        fetch(dataset)
    assert "Traceback" not in str(caught.value)
    cache_folder().mkdir(exist_ok=True)
    (cache_folder() / "drive.clf.bz2").write_bytes(content)
    assert fetch(dataset) == [cache_folder() / "drive.clf.bz2"]


def test_a_missing_file_is_said_with_the_servers_answer(dataset, server):
    del server.contents["drive.clf.bz2"]
    with pytest.raises(MapmendError, match="the server answers 404"):
        fetch(dataset)


def test_a_cache_that_cant_be_written_is_said_with_the_way_out(dataset, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("MAPMEND_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(OutputError, match=r"can't be written .*; name another folder with MAPMEND_CACHE"):
        fetch(dataset)


def test_a_read_only_cache_serves_what_it_has(dataset, tmp_path):
    path = fetch(dataset)[0]
    cache_folder().chmod(0o555)
    try:
        assert fetch(dataset) == [path]
        assert isinstance(read(named_file("drive")), ScanLog)
        if os.geteuid() != 0:  # root writes everywhere
            wanted = replace(dataset, files=(replace(dataset.files[0], name="other.clf.bz2"),))
            with pytest.raises(OutputError, match="name another folder with MAPMEND_CACHE"):
                fetch(wanted)
    finally:
        cache_folder().chmod(0o755)


def test_a_file_that_is_there_comes_before_a_public_log_of_its_name(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fetched_path("nothing of ours") is None
    (tmp_path / "drive").write_text("1.5 0 0 0 0 0 0.6 0.8\n")
    assert len(read(named_file("drive"))) == 1


def test_names_are_resolved_by_commands_alone(dataset, tmp_path, monkeypatch, mapmend):
    monkeypatch.chdir(tmp_path)
    fetch(dataset)
    with pytest.raises(InputError, match="drive: no such file"):
        read("drive")
    assert "20" in mapmend("info", "drive").out
    assert mapmend("map", "drive", "-o", "run", "--method", "odometry").code == 0
    assert json.loads(Path("run/run.json").read_text())["log"] == "drive"
    assert mapmend("convert", "drive", "path.tum").code == 0
    assert mapmend("eval", "drive", "--reference", "drive").code == 0
    assert mapmend("compare", "drive", "-o", "beside", "--methods", "odometry").code == 0
    for command in (("check",), ("tune",), ("optimize", "-o", "out.g2o")):
        assert "holds no pose graph" in mapmend(*command, "drive").complaint


def test_a_name_that_no_file_can_have_is_left_to_the_reader(dataset):
    for name in ("x" * 5000, "x\0y"):
        with pytest.raises(InputError, match=r"can't be read|no such file"):
            read(named_file(name))


def test_the_command_shows_licence_and_citation(dataset, server, mapmend):
    assert "drive  a drive; not fetched" in mapmend("datasets").out
    answer = mapmend("datasets", "fetch", "drive", "--mirror", server.url)
    assert answer.code == 0
    assert "licence: CC-BY 3.0" in answer.out
    assert "cite: Somebody: A drive. 2026" in answer.out
    page = json.loads(mapmend("datasets", "--json").out)
    assert page["datasets"][0]["fetched"] is True
    wrong = mapmend("datasets", "fetch", "driv")
    assert wrong.code == 2
    assert "there is no dataset 'driv'; there are drive" in wrong.complaint


def test_every_dataset_is_pinned_and_has_its_terms():
    names = [dataset.name for dataset in registry.DATASETS]
    files = [file for dataset in registry.DATASETS for file in dataset.files]
    assert len(set(names)) == len(names)
    assert len({file.name for file in files}) == len(files)
    for file in files:
        assert len(file.sha256) == 64
        assert file.url.startswith("https://")
        assert file.url.endswith(file.name)
        assert any(len(part) == 40 for part in file.url.split("/"))  # a commit
    for dataset in registry.DATASETS:
        assert dataset.licence
        assert dataset.citation


HELD = {"intel": "logs/intel.clf.bz2", "fr079": "logs/fr079.clf.bz2", "fr-clinic": "logs/fr-clinic.clf.bz2"}


@pytest.mark.parametrize("name", HELD)
def test_the_pinned_hashes_are_those_of_the_recordings(name, server, monkeypatch, tmp_path, mapmend):
    monkeypatch.setenv("MAPMEND_CACHE", str(tmp_path / "cache"))
    for file in registry.find(name).files:
        source = HELD[name] if file.name.endswith("bz2") else f"relations/{file.name}"
        server.contents[file.name] = data_path(source).read_bytes()
    answer = mapmend("datasets", "fetch", name, "--mirror", server.url)
    assert answer.code == 0
    assert fetched_path(name) is not None
