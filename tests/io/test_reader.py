import bz2
import gzip
import json
import os

import numpy as np
import pytest

from mapmend.errors import InputError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.g2o import write_g2o
from mapmend.io.graph_lines import parse_graph
from mapmend.io.info import components, describe
from mapmend.io.nav2 import write_map
from mapmend.io.reader import open_text, read, read_bytes
from mapmend.io.relations import Relations
from mapmend.io.tum import write_tum
from mapmend.maps import OccupancyMap
from mapmend.scan import ScanLog
from mapmend.trajectory import Trajectory
from tests.io.samples import short_graph, short_log
from tests.real_data import data_path

TUM = "# stamp x y z qx qy qz qw\n1.5 0 0 0 0 0 0.6 0.8\n2.5 1 0 0 0 0 0.6 0.8\n"
RELATIONS = "1.5 2.5 0.1 0.2 0 0 0 0.3\n"
KINDS = {
    "log": (short_log(), ScanLog),
    "graph": (short_graph(), PoseGraph),
    "trajectory": (TUM, Trajectory),
    "relations": (RELATIONS, Relations),
    "table": ("1.0, 2.0, 3.0\n4.0, 5.0, 6.0\n", np.ndarray),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pack", [bytes, gzip.compress, bz2.compress])
def test_content_decides_not_the_name(tmp_path, kind, pack):
    text, expected = KINDS[kind]
    path = tmp_path / "file.dat"
    path.write_bytes(pack(text.encode()))
    assert isinstance(read(path), expected)
    info = describe(path)
    assert info.kind == kind
    assert json.loads(json.dumps(info.to_dict()))["kind"] == kind
    assert info.lines()[0].endswith(f": {kind}")


def test_map_and_picture(tmp_path):
    write_map(tmp_path, OccupancyMap(np.full((3, 2), 254, np.uint8), 0.05))
    assert isinstance(read(tmp_path / "map.yaml"), OccupancyMap)
    assert read(tmp_path / "map.pgm").shape == (3, 2)
    assert describe(tmp_path / "map.yaml").facts["free_cells"] == 6
    assert describe(tmp_path / "map.pgm").kind == "picture"


@pytest.mark.parametrize(
    "data",
    [b"", b"\n \n", b"# only a comment\n", b"hello world\n", bytes(range(256)) * 4, b"\x00" * 99, b"\x89PNG\r\n"],
)
def test_unknown_content_is_refused_with_a_mend(tmp_path, data):
    path = tmp_path / "file.dat"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read(path)
    assert caught.value.mend


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
@pytest.mark.parametrize("damage", ["cut", "flipped", "head"])
def test_broken_archive_is_refused(tmp_path, pack, damage):
    data = bytearray(pack(short_log().encode() * 20))
    if damage == "cut":
        data = data[: len(data) // 2]
    elif damage == "head":
        data = data[:5]
    else:
        data[len(data) // 2] ^= 0x55
    path = tmp_path / "log.gz"
    path.write_bytes(bytes(data))
    with pytest.raises(InputError, match="broken archive"):
        read(path)


def test_concatenated_archives_are_read_whole(tmp_path):
    path = tmp_path / "two.bz2"
    path.write_bytes(bz2.compress(b"one\n") + bz2.compress(b"two\n"))
    assert read_bytes(path) == b"one\ntwo\n"


def test_folder_missing_file_and_no_permission(tmp_path):
    with pytest.raises(InputError, match="directory"):
        read(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "none")
    with pytest.raises(InputError):
        read("nul\0name")
    locked = tmp_path / "locked"
    locked.write_text("x")
    locked.chmod(0)
    if os.access(locked, os.R_OK):
        pytest.skip("this user may read everything")
    with pytest.raises(InputError, match="may not be read"):
        read(locked)


def test_text_has_plain_line_ends(tmp_path):
    (tmp_path / "t").write_bytes(b"a\r\nb\r\n")
    assert open_text(tmp_path / "t") == "a\nb\n"
    (tmp_path / "t").write_bytes(b"\xff\xff")
    with pytest.raises(InputError, match="not text"):
        open_text(tmp_path / "t")


def test_lenient_reaches_the_log(tmp_path):
    (tmp_path / "log").write_text(short_log() + "FLASER 3 1.0\n")
    with pytest.raises(InputError):
        read(tmp_path / "log")
    assert "unusable line left out" in str(describe(tmp_path / "log", lenient=True).notes)


def test_graph_facts():
    text = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(5)) + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    graph = parse_graph((text + "EDGE_SE2 4 3 1 0 0 1 0 0 1 0 1\n" * 2).encode(), "g")
    assert components(graph) == 3


def test_run_folder_is_described(tmp_path):
    write_tum(tmp_path / "trajectory.tum", np.arange(3.0), np.zeros((3, 3)))
    write_g2o(tmp_path / "graph.g2o", parse_graph(short_graph().encode(), "g"))
    (tmp_path / "run.json").write_text("{}")
    info = describe(tmp_path)
    assert info.kind == "run"
    assert info.facts["graph"]["nodes"] == 4
    assert any("poses 3" in line for line in info.lines())


def test_facts_of_a_real_log():
    facts = describe(data_path("logs/intel.clf.bz2")).facts
    assert facts["scans"] == 13631
    assert round(facts["odometry_path_m"]) == 508
    assert round(facts["duration_s"]) == 2691
    assert facts["lasers"][0]["beams"] == 180


@pytest.mark.parametrize("folder", ["logs", "keyscans", "scangraphs", "posegraphs", "relations"])
def test_every_real_file_is_recognised(folder):
    for path in sorted(data_path(folder).iterdir()):
        assert describe(path).kind in {"log", "graph", "relations", "table"}, path.name
