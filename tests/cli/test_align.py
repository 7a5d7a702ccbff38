"""``mapmend map --align``: one turn for everything in the RUN, given in run.json; and the map as others read it."""

import json

import numpy as np
import pytest
import yaml
from PIL import Image

from mapmend.geometry.se2 import compose, wrap_angle
from mapmend.io.nav2 import read_map
from mapmend.io.reader import read_run


@pytest.fixture(scope="module")
def runs(log_path, tmp_path_factory):
    """The same log mapped as it comes and with straight walls."""
    from mapmend.cli import main

    folder = tmp_path_factory.mktemp("runs")
    for name, more in (("plain", []), ("straight", ["--align"])):
        assert main(["map", str(log_path), "-o", str(folder / name), "--json", *more]) == 0
    return folder / "plain", folder / "straight"


def test_one_turn_for_trajectory_and_graph(runs):
    plain, straight = runs
    page = json.loads((straight / "run.json").read_text())
    assert page["configuration"]["grid"]["align"] is True
    assert json.loads((plain / "run.json").read_text())["alignment"] is None
    turn = np.array(page["alignment"]["T_map_start"])
    assert turn[2] != 0.0
    for before, after in zip(read_run(plain), read_run(straight), strict=True):
        off = after.poses - compose(turn, before.poses)
        np.testing.assert_allclose(off[:, :2], 0.0, atol=1e-6)
        np.testing.assert_allclose(wrap_angle(off[:, 2]), 0.0, atol=1e-6)
    # Edges are measured between nodes: no turn changes them.
    assert np.array_equal(read_run(plain)[1].measurements, read_run(straight)[1].measurements)


def test_the_corridors_walls_lie_in_few_rows(runs):
    """The log's first corridor is 60 m of wall along x: straight, it fills few rows of the map and fills them well."""
    rows = []
    for run in runs:
        occupied = read_map(run / "map.yaml").image == 0
        by_length = np.sort(np.count_nonzero(occupied, axis=1))[::-1]
        rows.append(by_length[:8].sum() / occupied.sum())
    assert rows[1] > rows[0]
    assert rows[1] > 0.6


def test_map_reads_the_same_by_pillow_and_yaml(runs):
    """The map as another program reads it: PGM by Pillow, the YAML file by a parser, both as in nav2's map server."""
    page = yaml.safe_load((runs[1] / "map.yaml").read_text())
    ours = read_map(runs[1] / "map.yaml")
    assert set(page) == {"image", "mode", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"}
    assert (page["resolution"], tuple(page["origin"])) == (ours.resolution_m, ours.origin)
    assert (page["mode"], page["negate"]) == ("trinary", 0)
    with Image.open(runs[1] / page["image"]) as picture:
        assert picture.mode == "L"
        cells = np.asarray(picture)
    np.testing.assert_array_equal(cells[::-1], ours.image)
    # nav2 scales by occupancy = (255 - cell) / 255 and compares with its thresholds.
    occupancy = (255.0 - cells) / 255.0
    assert np.array_equal(occupancy > page["occupied_thresh"], cells == 0)
    assert np.array_equal(occupancy < page["free_thresh"], cells == 254)
    assert {0, 205, 254} == set(np.unique(cells).tolist())


def test_origin_places_the_robot_on_free_floor(runs):
    for run in runs:
        page = yaml.safe_load((run / "map.yaml").read_text())
        with Image.open(run / page["image"]) as picture:
            cells = np.asarray(picture)
        at = (read_run(run)[0].poses[:, :2] - np.array(page["origin"][:2])) / page["resolution"]
        columns, rows = np.floor(at).astype(int).T
        under = cells[len(cells) - 1 - rows, columns]
        # Where the drive began, no beam has passed under the robot itself: unknown, but nowhere a wall.
        assert not (under == 0).any()
        assert np.mean(under == 254) > 0.8


def test_no_main_direction_is_told(mapmend, tmp_path):
    """A robot in a round hall: the map is written as it comes, and a line says why."""
    from mapmend.io.carmen import write_carmen
    from mapmend.scan import LaserGeometry, ScanLog, Scans
    from mapmend.simulation.ray_casting import cast_rays

    laser = LaserGeometry(181, -np.pi / 2.0, np.pi / 180.0, 30.0)
    around = np.linspace(0.0, 2.0 * np.pi, 181)
    ring = np.column_stack((6.0 * np.cos(around), 5.9 * np.sin(around)))
    poses = np.column_stack((np.linspace(-1.0, 1.0, 21), np.zeros(21), np.linspace(0.0, 6.0, 21)))
    ranges = cast_rays(np.hstack((ring[:-1], ring[1:])), poses, laser.bearings_rad(), laser.max_range_m)
    offsets = np.arange(22, dtype=np.int64) * laser.beam_count
    scans = Scans(ranges.astype(np.float32).ravel(), offsets, np.zeros(21, np.int32), (laser,))
    write_carmen(tmp_path / "round.clf", ScanLog(scans, np.arange(21.0), poses))
    answer = mapmend("map", tmp_path / "round.clf", "-o", tmp_path / "run", "--align", "--json")
    assert answer.code == 0
    assert "no main direction" in answer.err
    assert json.loads(answer.out)["alignment"]["T_map_start"] == [0.0, 0.0, 0.0]
