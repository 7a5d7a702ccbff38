"""Bad input is refused in one line with exit code 2, and no incomplete output remains."""

import numpy as np
import pytest

from mapmend.commands.common import options
from mapmend.slam import METHODS
from tests.cli.interrupts import interrupted


@pytest.fixture
def refused(mapmend, tmp_path):
    """Maps a file that can't be mapped; gives the complaint, after seeing that nothing was left."""

    def call(content, *options):
        path = tmp_path / "bad.clf"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        answer = mapmend("map", path, "-o", tmp_path / "run", *options)
        assert answer.code == 2
        assert answer.out == ""
        assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.clf"]
        assert str(path) in answer.complaint or "method" in answer.complaint
        return answer.complaint

    return call


@pytest.fixture
def lines(log_path):
    return log_path.read_text().splitlines()


def first_scan(lines):
    return next(k for k, line in enumerate(lines) if line.startswith("FLASER"))


def with_word(lines, row, word, value):
    words = lines[row].split()
    words[word] = value
    return "\n".join([*lines[:row], " ".join(words), *lines[row + 1 :]]) + "\n"


def test_an_empty_file(refused):
    assert "empty" in refused("")


def test_binary_noise(refused):
    assert "known kind" in refused(np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes())


def test_a_truncated_last_line(refused, lines, mapmend, tmp_path):
    content = "\n".join(lines)[:-200]
    assert f"bad.clf:{len(lines)}: " in refused(content)
    answer = mapmend("map", tmp_path / "bad.clf", "-o", tmp_path / "run", "--lenient", "--method", "odometry")
    assert answer.code == 0
    assert "note: unusable line left out" in answer.err


@pytest.mark.parametrize("value", ["nan", "inf", "-1.0"])
def test_readings_that_are_no_ranges(refused, lines, value):
    row = first_scan(lines) + 3
    assert f"bad.clf:{row + 1}: " in refused(with_word(lines, row, 20, value))


@pytest.mark.parametrize("count", ["179", "181", "1000000000000", "abc"])
def test_a_beam_count_that_disagrees(refused, lines, count):
    row = first_scan(lines) + 2
    assert f"bad.clf:{row + 1}: " in refused(with_word(lines, row, 1, count))


def test_a_log_without_odometry(refused, lines, mapmend, tmp_path):
    still = []
    for line in lines[: first_scan(lines) + 80]:
        words = line.split()
        if words[0] == "FLASER":
            words[-9:-3] = ["0"] * 6
        still.append(" ".join(words))
    content = "\n".join(still) + "\n"
    assert "run with --no-odometry" in refused(content)
    assert "needs odometry" in refused(content, "--no-odometry", "--method", "odometry")
    answer = mapmend("map", tmp_path / "bad.clf", "-o", tmp_path / "run", "--no-odometry")
    assert answer.code == 0
    assert len((tmp_path / "run" / "trajectory.tum").read_text().splitlines()) == 80


def test_a_single_scan(refused, lines):
    assert "at least two" in refused("\n".join(lines[: first_scan(lines) + 1]) + "\n")


def test_scans_that_see_nothing(refused, lines):
    blind = []
    for line in lines:
        words = line.split()
        if words[0] == "FLASER":
            words[2 : 2 + int(words[1])] = ["8.0"] * int(words[1])
        blind.append(" ".join(words))
    assert "no scan has a return" in refused("\n".join(blind) + "\n")


def test_stamps_that_step_back_are_told_and_mapped(mapmend, lines, tmp_path):
    row = first_scan(lines) + 10
    words = lines[row].split()
    path = tmp_path / "back.clf"
    path.write_text(with_word(lines, row, len(words) - 3, "0.5"))
    answer = mapmend("map", path, "-o", tmp_path / "run")
    assert answer.code == 0
    assert "note: timestamp steps back" in answer.err
    assert len((tmp_path / "run" / "trajectory.tum").read_text().splitlines()) == 160


def test_a_file_that_is_not_there_and_one_that_is_no_log(mapmend, truth_path, tmp_path):
    assert "no such file" in mapmend("map", tmp_path / "none.clf", "-o", tmp_path / "run").complaint
    assert "holds a trajectory, not a log" in mapmend("map", truth_path, "-o", tmp_path / "run").complaint


def test_an_output_folder_that_cannot_be_written(mapmend, log_path, tmp_path):
    (tmp_path / "file").write_text("")
    for output in (tmp_path / "file" / "run", tmp_path / "file"):
        for command in (("map", log_path), ("simulate",), ("demo",)):
            answer = mapmend(*command, "-o", output)
            assert answer.code == 2
            assert str(output) in answer.complaint


def test_the_command_line_knows_the_methods():
    assert set(options.METHODS) == set(METHODS)
    assert options.METHODS[0] == "igo"


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["paint"],
        ["map"],
        ["map", "log"],
        ["map", "log", "-o", "run", "--method", "magic"],
        ["map", "log", "-o", "run", "--seed", "-1"],
        ["simulate", "-o", "x", "--range-noise", "nan"],
        ["simulate", "-o", "x", "--scans", "0"],
        ["eval", "log"],
    ],
)
def test_wrong_arguments_are_one_line(mapmend, arguments):
    answer = mapmend(*arguments)
    assert answer.code == 2
    assert answer.complaint


def test_a_configuration_that_is_wrong(mapmend, log_path, tmp_path):
    (tmp_path / "config.toml").write_text("[grid]\ncell_size = 1\n")
    answer = mapmend("map", log_path, "-o", tmp_path / "run", "--config", tmp_path / "config.toml")
    assert "config.toml: unknown key 'grid.cell_size'" in answer.complaint


@pytest.mark.parametrize("error", [MemoryError(), OSError(28, "No space left on device", "disk"), KeyError("x")])
def test_the_unexpected_is_one_line_too(mapmend, monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr("mapmend.io.info.describe", fail)
    answer = mapmend("info", "file")
    assert answer.code == 2
    assert answer.complaint


@pytest.mark.parametrize("stage", ["matching", "map"])
def test_ctrl_c_in_the_middle(log_path, tmp_path, stage):
    done = interrupted(stage, "map", log_path, "-o", tmp_path / "run")
    assert done.returncode == 130
    lines = [line for line in done.stderr.splitlines() if "compiling kernels" not in line]
    assert lines == ["mapmend: interrupted; nothing was written"]
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []
