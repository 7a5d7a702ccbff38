import bz2
import gzip

import numpy as np
import pytest
from hypothesis import given, settings

from mapmend.errors import InputError
from mapmend.io.carmen import MEND_LINE, parse_carmen, read_carmen, write_carmen
from mapmend.scan import LaserGeometry, ScanLog, Scans
from tests.io.samples import assert_same_scans, flaser, logs, robotlaser, short_log
from tests.real_data import data_path


def read(text: str | bytes, lenient: bool = False) -> ScanLog:
    return parse_carmen(text.encode() if isinstance(text, str) else text, "sample.clf", lenient)


def notes_of(log: ScanLog) -> str:
    return "\n".join(map(str, log.notes))


def test_short_log_is_read():
    log = read(short_log())
    assert len(log) == 5
    assert log.scans.geometries[0].T_robot_laser == (0.1, 0.0, 0.0)
    assert log.scans.geometries[0].max_range_m == 80.0
    np.testing.assert_allclose(log.odometry[:, 0], 0.2 * np.arange(5))
    np.testing.assert_allclose(log.stamps_s, 0.75 + np.arange(5))
    np.testing.assert_array_equal(log.scans.ranges_of(1)[:2], np.float32([1.10, 1.11]))


@settings(max_examples=60, deadline=None)
@given(logs())
def test_written_log_reads_back_the_same(tmp_path_factory, log):
    path = tmp_path_factory.mktemp("log") / "log.clf"
    write_carmen(path, log)
    back = read_carmen(path)
    assert_same_scans(back.scans, log.scans)
    np.testing.assert_array_equal(back.odometry, log.odometry)
    np.testing.assert_array_equal(back.stamps_s, log.stamps_s)
    assert back.has_stamps == log.has_stamps


def test_flaser_is_written_where_it_can_say_all(tmp_path):
    geometry = LaserGeometry(180, -np.pi / 2, np.pi / 180, 30.0, (0.1, 0.0, 0.0))
    ranges = np.full(180, 2.5, np.float32)
    ranges[0] = np.inf
    scans = Scans(ranges, np.array([0, 180]), np.zeros(1, np.int32), (geometry,))
    write_carmen(tmp_path / "log.clf", ScanLog(scans, np.array([5.0]), np.zeros((1, 3))))
    text = (tmp_path / "log.clf").read_text()
    assert "\nFLASER 180 30.0000 2.5000 2.5000" in text
    assert "PARAM robot_frontlaser_offset 0.1 " in text


GOOD = flaser()
BAD_LINES = {
    "truncated in the ranges": "FLASER 3 1.00 2.00",
    "truncated in the poses": "FLASER 3 1.00 2.00 3.00 0 0 0 0",
    "truncated in the tail": "FLASER 3 1.00 2.00 3.00 0 0 0 0 0 0 10.5 host",
    "truncated before the tail": "FLASER 3 1.00 2.00 3.00 0 0 0 0 0 0",
    "keyword alone": "FLASER",
    "nan reading": flaser("1.0 nan 2.0"),
    "infinite reading": flaser("1.0 inf 2.0"),
    "negative reading": flaser("1.0 -2.0 2.0"),
    "count too small": flaser(count=2),
    "count too large": flaser(count=4),
    "huge count": flaser(count="1e12"),
    "huge whole count": flaser(count=10**12),
    "negative count": flaser(count=-3),
    "broken count": flaser(count="3.5"),
    "count no number": flaser(count="many"),
    "no beams": flaser(""),
    "reading no number": flaser("1.0 abc 2.0"),
    "reading with underscore": flaser("1.0 1_0 2.0"),
    "two dots": flaser("1.0 1.2.3 2.0"),
    "pose no number": flaser(poses="0 0 x 0 0 0"),
    "pose nan": flaser(poses="0 0 0 nan 0 0"),
    "pose infinite": flaser(poses="0 0 0 0 -inf 0"),
    "pose absurd": flaser(poses="0 0 0 0 1e300 0"),
    "stamp nan": flaser(tail=" nan host 0"),
    "stamp no number": flaser(tail=" noon host 0"),
    "stamp infinite": flaser(tail=" inf host 0"),
    "binary noise in a line": "FLASER 3 \x01\x02\xff\xfe",
    "robotlaser truncated": "ROBOTLASER1 0 -1.57 3.14 0.0174 80.0 0.01 0 3 1.0 2.0",
    "robotlaser header no number": robotlaser(header="0 x 1.0 0.5 30.0 0.01 0"),
    "robotlaser header nan": robotlaser(header="0 -0.5 1.0 nan 30.0 0.01 0"),
    "robotlaser without resolution": robotlaser(header="0 -0.5 1.0 0 30.0 0.01 0"),
    "robotlaser nan reading": robotlaser("1.0 nan 2.0"),
    "robotlaser pose nan": robotlaser(poses="0.1 0 0 0 nan 0"),
}


@pytest.mark.parametrize("name", BAD_LINES)
@pytest.mark.parametrize("last", [False, True])
def test_bad_line_is_named(name, last):
    lines = ["# comment", GOOD, BAD_LINES[name]] if last else ["# comment", GOOD, BAD_LINES[name], GOOD]
    with pytest.raises(InputError) as caught:
        read("\n".join(lines))
    assert caught.value.line == 3
    assert str(caught.value).startswith("sample.clf:3: ")
    assert "--lenient" in str(caught.value)
    assert caught.value.mend == MEND_LINE
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", BAD_LINES)
def test_lenient_leaves_bad_lines_out(name):
    log = read("\n".join([GOOD, BAD_LINES[name], GOOD.replace("10.5", "11.5")]), lenient=True)
    reading_only = name in {"nan reading", "infinite reading", "negative reading", "robotlaser nan reading"}
    assert len(log) == (3 if reading_only else 2)
    assert np.count_nonzero(np.isnan(log.scans.ranges_m)) == (1 if reading_only else 0)
    assert "left out, first in line 2" in notes_of(log)


@pytest.mark.parametrize("text", ["", "\n\n", "# nothing\n", "ODOM 0 0 0 0 0 0 1.0 host 0\n", "\x00\xff\x01" * 50])
def test_file_without_scans_is_refused(text):
    with pytest.raises(InputError):
        read(text.encode("latin-1"))


def test_only_bad_lines_leniently_is_refused():
    with pytest.raises(InputError, match="no usable scans"):
        read("FLASER 3 1.0", lenient=True)


def test_header_claiming_less_than_the_sentinel():
    text = robotlaser("1.0 60.0 81.83", header="0 -0.5 1.0 0.5 50.0 0.01 0")
    assert np.isinf(read(text).scans.ranges_m).tolist() == [False, True, True]


def test_header_claiming_more_than_the_sentinel():
    text = robotlaser("1.0 60.0 81.91", header="0 -0.5 1.0 0.5 200.0 0.01 0")
    log = read(text)
    assert np.isinf(log.scans.ranges_m).tolist() == [False, False, True]
    assert "81.83" in notes_of(log)


def test_sick_codes_without_any_header():
    assert np.isinf(read(flaser("1.0 81.83 81.91")).scans.ranges_m).tolist() == [False, True, True]


def test_frequent_maximum_is_no_return():
    random = np.random.default_rng(1)
    lines = []
    for k in range(60):
        ranges = np.round(random.uniform(0.5, 40.0, 40), 2)
        ranges[random.random(40) < 0.1] = 51.16
        ranges[random.random(40) < 0.05] = 51.1
        lines.append(flaser(" ".join(f"{r:.2f}" for r in ranges), tail=f" {k}.5 host 0"))
    log = read("\n".join(lines))
    assert log.scans.geometries[0].max_range_m == 51.1
    assert np.nanmax(log.scans.ranges_m[np.isfinite(log.scans.ranges_m)]) <= 40.0


def test_a_room_has_no_frequent_maximum():
    ranges = " ".join(f"{2 + 0.05 * k:.2f}" for k in range(60))
    log = read("\n".join(flaser(ranges, tail=f" {k}.5 host 0") for k in range(40)))
    assert not np.isinf(log.scans.ranges_m).any()
    assert log.scans.geometries[0].max_range_m == 80.0


def test_zero_reading_is_unusable():
    log = read(flaser("1.0 0.00 2.0"))
    assert np.isnan(log.scans.ranges_m).tolist() == [False, True, False]
    assert "zero" in notes_of(log)


def test_windows_line_ends_exponents_and_comments():
    text = "# c\r\n" + flaser("1.12e+001 2.0 +3.0", "1e-1 0 0 0 0 0") + "\r\n#c\r\n"
    log = read(text)
    np.testing.assert_array_equal(log.scans.ranges_m, np.float32([11.2, 2.0, 3.0]))
    assert log.scans.geometries[0].T_robot_laser == (0.1, 0.0, 0.0)


def test_front_and_rear_laser_in_one_log():
    lines = ["PARAM robot_rearlaser_offset -0.3 nohost 0", "PARAM robot_frontlaser_offset 0.2 nohost 0"]
    lines += [flaser(), flaser(word="RLASER", tail=" 10.6 h 0"), flaser(tail=" 10.7 h 0")]
    log = read("\n".join(lines))
    assert [log.scans.geometry_of(k).T_robot_laser[0] for k in range(3)] == [0.2, -0.3, 0.2]
    assert log.scans.geometry_of(1).T_robot_laser[2] == pytest.approx(np.pi)
    assert log.stamps_s.tolist() == [10.5, 10.6, 10.7]


def test_rear_laser_of_robotlaser2():
    lines = [robotlaser(), robotlaser(poses="-0.2 0 3.141593 0 0 0", stamp="11").replace("ROBOTLASER1", "ROBOTLASER2")]
    log = read("\n".join(lines))
    np.testing.assert_allclose(log.scans.geometry_of(1).T_robot_laser, (-0.2, 0.0, np.pi), atol=1e-6)


def test_beam_counts_that_change_share_geometries():
    ranges = [" ".join(["1.0"] * n) for n in (180, 181, 180, 361)]
    log = read("\n".join(flaser(r, tail=f" {k}.5 h 0") for k, r in enumerate(ranges)))
    assert [g.beam_count for g in log.scans.geometries] == [180, 181, 361]
    assert log.scans.geometry_index.tolist() == [0, 1, 0, 2]
    assert [round(np.rad2deg(g.angle_increment_rad), 9) for g in log.scans.geometries] == [1.0, 1.0, 0.5]
    assert "guess" not in notes_of(log)


def test_unknown_beam_count_is_guessed_aloud():
    assert "taken as field of view" in notes_of(read(flaser(" ".join(["1.0"] * 90))))
    told = read("PARAM laser_front_laser_resolution 0.25 h 0\n" + flaser(" ".join(["1.0"] * 401)))
    assert np.rad2deg(told.scans.geometries[0].first_angle_rad) == pytest.approx(-50.0)
    assert "taken as field of view" not in notes_of(told)


def test_printed_angles_go_back_to_quarter_degrees():
    log = read(robotlaser(header="0 -1.566433 3.141593 0.017453 81.9 0.01 0"))
    geometry = log.scans.geometries[0]
    assert geometry.angle_increment_rad == pytest.approx(np.pi / 180, abs=1e-15)
    assert np.rad2deg(geometry.first_angle_rad) == pytest.approx(-89.75, abs=1e-12)


def test_corrected_poses_put_the_laser_at_the_centre():
    lines = [flaser(poses="5 1 0.3 0 0 0"), flaser(poses="7 2 0.5 1 0 0", tail=" 11.5 h 0")]
    log = read("\n".join(lines))
    assert log.scans.geometries[0].T_robot_laser == (0.0, 0.0, 0.0)
    assert "corrected" in notes_of(log)
    assert log.odometry[1].tolist() == [1.0, 0.0, 0.0]


def test_stamps_that_step_back_or_repeat_keep_the_order_of_lines():
    log = read("\n".join(flaser(tail=f" {t} h 0") for t in (5.0, 6.0, 6.0, 4.0)))
    assert log.stamps_s.tolist() == [5.0, 6.0, 6.0, 4.0]
    assert log.has_stamps
    assert "timestamp steps back, first in line 4" in notes_of(log)
    assert "timestamp repeats the one before, first in line 3" in notes_of(log)


@pytest.mark.parametrize("tails", [(" 7 h 0", " 7 h 0", " 7 h 0"), ("", "", ""), (" 0 h 0", " 1 h 0", " 2 h 0")])
def test_log_without_usable_stamps_is_numbered(tails):
    log = read("\n".join(flaser(tail=tail) for tail in tails))
    assert not log.has_stamps
    assert log.stamps_s.tolist() == [0.0, 1.0, 2.0]
    assert "numbered" in notes_of(log)


def test_odometry_jump_is_noted():
    log = read("\n".join(flaser(poses=f"0 0 0 {x} 0 0", tail=f" {x + 0.5} h 0") for x in (0, 0.5, 3.0)))
    assert "odometry jumps" in notes_of(log)


def test_odometry_that_never_moves_is_read():
    log = read("\n".join(flaser(tail=f" {k}.5 h 0") for k in range(3)))
    assert not log.odometry_moves


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_packed_log_is_read_whatever_its_name(tmp_path, pack):
    path = tmp_path / "log.txt"
    path.write_bytes(pack(short_log().encode()))
    assert len(read_carmen(path)) == 5


REAL = {
    "logs/intel.clf.bz2": (13631, {180}, 0.0),
    "logs/fr079.clf.bz2": (4934, {360}, -0.04),
    "logs/fr-clinic.clf.bz2": (6917, {180, 181}, 0.22),
    "keyscans/belgioioso.clf.gz": (395, {361}, 0.0),
    "keyscans/edmonton.clf.gz": (340, {180}, 0.0),
}


@pytest.mark.parametrize("name", REAL)
def test_real_log(name):
    count, beams, x = REAL[name]
    log = read_carmen(data_path(name))
    assert len(log) == count
    assert {g.beam_count for g in log.scans.geometries} == beams
    assert {g.T_robot_laser for g in log.scans.geometries} == {(x, 0.0, 0.0)}
    finite = log.scans.ranges_m[np.isfinite(log.scans.ranges_m)]
    assert finite.max() < 81.825
    assert 0.0 < np.isinf(log.scans.ranges_m).mean() < 0.2


def test_intel_steps_back_631_times():
    log = read_carmen(data_path("logs/intel.clf.bz2"))
    assert np.count_nonzero(np.diff(log.stamps_s) < 0.0) == 631
    assert "timestamp steps back (631 times)" in notes_of(log)


def test_belgioioso_has_no_usable_stamps():
    assert not read_carmen(data_path("keyscans/belgioioso.clf.gz")).has_stamps
