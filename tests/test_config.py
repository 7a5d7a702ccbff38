"""The configuration: out to TOML and back, and what it refuses."""

from contextlib import suppress
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapmend.config import REACH_CELLS, Config, from_dict, read_toml, to_dict, to_toml
from mapmend.errors import InputError
from mapmend.grid import _kernels

BLOCKS = [f.name for f in fields(Config) if f.name != "seed"]


def values_like(key, default):
    if isinstance(default, bool):
        return st.booleans()
    if isinstance(default, int):
        return st.integers(1, 10**6)
    # Some of what has no unit is a share.
    return st.floats(1e-6, 1e3 if key.endswith(("_m", "_rad")) else 0.999)


@st.composite
def configs(draw):
    """Any configuration: some values of some blocks replaced by others of their type, kept where they go together."""
    config = Config(seed=draw(st.integers(0, 2**31)))
    for name in draw(st.sets(st.sampled_from(BLOCKS))):
        block = getattr(config, name)
        for key in draw(st.sets(st.sampled_from([f.name for f in fields(block)]))):
            with suppress(InputError):
                config = config.with_settings({f"{name}.{key}": draw(values_like(key, getattr(block, key)))})
    return config


@given(configs())
def test_a_configuration_comes_back_from_its_toml(tmp_path_factory, config):
    path = tmp_path_factory.mktemp("config") / "c.toml"
    path.write_text(to_toml(config))
    assert read_toml(path) == config


@given(configs())
def test_a_configuration_comes_back_from_its_tables(config):
    assert from_dict(to_dict(config)) == config


def test_keys_that_are_not_there_keep_their_defaults(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("[grid]\ncell_size_m = 0.1\n")
    config = read_toml(path)
    assert config == replace(Config(), grid=replace(Config().grid, cell_size_m=0.1))
    path.write_text("")
    assert read_toml(path) == Config()


def test_whole_numbers_do_for_fractions(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text("[scan]\nmax_range_m = 8\n")
    value = read_toml(path).scan.max_range_m
    assert (value, type(value)) == (8.0, float)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("sneed = 1", "unknown key 'sneed'"),
        ("[grid]\ncell_size = 0.1", "unknown key 'grid.cell_size'"),
        ("[grids]\ncell_size_m = 0.1", "unknown key 'grids'"),
        ("grid = 0.1", "'grid' must be a table"),
        ("seed = 'one'", "'seed'"),
        ("seed = 1.5", "'seed'"),
        ("seed = -1", "'seed'"),
        ("seed = true", "'seed'"),
        ("[grid]\ncell_size_m = '5 cm'", "'grid.cell_size_m'"),
        ("[grid]\ncell_size_m = [0.1]", "'grid.cell_size_m'"),
        ("[grid]\ncell_size_m = -0.05", "'grid.cell_size_m'"),
        ("[grid]\ncell_size_m = nan", "'grid.cell_size_m'"),
        ("[grid]\ncell_size_m = inf", "'grid.cell_size_m'"),
        ("[grid]\ncell_size_m = true", "'grid.cell_size_m'"),
        ("[motion]\nuse_odometry = 1", "'motion.use_odometry' is 1; give true or false"),
        ("[motion]\nhypotheses = 2.5", "'motion.hypotheses'"),
        ("[grid", "is not TOML"),
    ],
)
def test_what_is_wrong_is_said_in_one_line_that_names_the_file(tmp_path, text, complaint):
    path = tmp_path / "c.toml"
    path.write_text(text + "\n")
    with pytest.raises(InputError) as raised:
        read_toml(path)
    message = str(raised.value)
    assert complaint in message
    assert message.startswith(str(path))
    assert "\n" not in message


@pytest.mark.parametrize(
    "text",
    [
        "[scan]\nmax_range_m = 0.0",
        "[scan]\nmax_range_m = 0.05",
        "[scan]\nmin_range_m = 30.0",
        "[scan]\nmin_range_m = 5\nmax_range_m = 4",
        "[scan]\nsurface_gap = 1.1",
        "[grid]\ncell_size_m = 0.0",
        "[grid]\ncell_size_m = -0.0",
        "[match]\nreach_m = 0",
        "[match]\nhalf_weight_m = 0.0",
        "[match]\ndistance_std_m = 0.0",
        "[match]\niterations = 0",
        "[match]\nwidening = 0.0",
        "[match]\nmin_score = 1.01",
        "[motion]\nmin_translation_std_m = 0.0",
        "[motion]\nmin_rotation_std_rad = 0.0",
        "[motion]\nrotation_std_per_m = 1" + 400 * "0",
        "[key_nodes]\nnode_every_m = 0.0",
        "[key_nodes]\nnode_every_rad = 0.0",
        "[key_nodes]\ntrajectory_length_m = 0.0",
        "[loops]\ngate_quantile = 1.5",
        "[loops]\ngate_quantile = 1.0",
        "[loops]\ngate_quantile = 0.0",
        "[loops]\nguess_every_m = 0.0",
        "[loops]\ncertain_std_m = 0.0",
        "[loops]\ncertain_std_rad = 0.0",
        "[loops]\nmin_likelihood = 2",
        "[loops]\nmin_score = 1.5",
        "[loops]\nmin_agreement = 90.0",
        "[loops]\nmin_overlap = 1.0001",
        "[loops]\nmin_observability = 1.5",
    ],
)
def test_values_that_nothing_works_with_are_refused(tmp_path, text):
    path = tmp_path / "c.toml"
    path.write_text(text + "\n")
    with pytest.raises(InputError) as raised:
        read_toml(path)
    message = str(raised.value)
    block, key = text.split("\n")[0][1:-1], text.split("\n")[1].split(" = ")[0]
    assert message.startswith(f"{path}: '{'scan.max_range_m' if key == 'min_range_m' else f'{block}.{key}'}' is ")
    assert "; give " in message
    assert "\n" not in message


def test_what_may_be_asked_for_is_said():
    for tables, wanted in (
        ({"match": {"min_score": 1.2}}, "'match.min_score' is 1.2; give a number not below 0 and not above 1"),
        ({"loops": {"gate_quantile": 1}}, "'loops.gate_quantile' is 1; give a number above 0 and below 1"),
        ({"match": {"iterations": 0}}, "'match.iterations' is 0; give a whole number above 0"),
        ({"scan": {"min_range_m": 40}}, "'scan.max_range_m' is 30.0; give more than scan.min_range_m, 40"),
    ):
        with pytest.raises(InputError) as raised:
            from_dict(tables)
        assert str(raised.value) == wanted


def outcome(make):
    """The block that comes of it, or the complaint."""
    try:
        return str(make())
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf"), -1, "1", None, [1.0], True, 1, 10**400])
def test_python_refuses_what_toml_refuses(value):
    """A block, a Config and a table of TOML take the same values, and name the same setting, value and bounds."""
    for block in BLOCKS:
        usual = getattr(Config(), block)
        for key in (f.name for f in fields(usual)):
            ways = (
                partial(lambda block, key: replace(getattr(Config(), block), **{key: value}), block, key),
                partial(lambda block, key: Config().with_settings({f"{block}.{key}": value}), block, key),
                partial(lambda block, key: from_dict({block: {key: value}}), block, key),
            )
            alone, python, toml = map(outcome, ways)
            assert python == toml
            of_its_type = isinstance(value, bool) is isinstance(getattr(usual, key), bool)
            if value != 1 or not of_its_type:
                assert alone == python
                assert alone.startswith(f"'{block}.{key}' is {value!r}; give ")


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"scan.min_range_m": 30}, "'scan.max_range_m' is 30.0; give more than scan.min_range_m, 30"),
        ({"consistency.min_range_m": 8}, "'consistency.max_range_m' is 8.0; give more than consistency.min_range_m, 8"),
        ({"scan.min_range_m": 9}, "'consistency.max_range_m' is 8.0; give more than scan.min_range_m, 9"),
        ({"match.reach_m": 0.21}, "'match.reach_m' is 0.21; give at most 0.2: "),
        ({"grid.cell_size_m": 0.04}, "'match.reach_m' is 0.2; give at most 0.16: "),
        ({"key_nodes.trajectory_length_m": 10}, "'loops.min_separation_m' is 10.0; give at least 15, 1.5 times "),
        ({"loops.min_separation_m": 7}, "'loops.min_separation_m' is 7.0; give at least 7.5, 1.5 times "),
        (
            {"consistency.least_inflation": 3},
            "'consistency.most_inflation' is 2.0; give 3 (",
        ),
    ],
)
def test_settings_that_do_not_go_together_are_refused(values, complaint):
    with pytest.raises(InputError) as raised:
        Config().with_settings(values)
    assert str(raised.value).startswith(complaint)


def test_settings_that_go_together_are_put_in_together():
    config = Config().with_settings({"key_nodes.trajectory_length_m": 10, "loops.min_separation_m": 15, "seed": 3})
    assert (config.key_nodes.trajectory_length_m, config.loops.min_separation_m, config.seed) == (10.0, 15.0, 3)
    assert Config().with_settings({"match.reach_m": 0.4, "grid.cell_size_m": 0.1}).match.reach_m == 0.4


def test_a_name_that_there_is_not_is_answered_with_the_nearest():
    with pytest.raises(InputError, match=r"unknown key 'loops.tun'; the nearest is 'loops.tune'"):
        Config().with_settings({"loops.tun": True})
    with pytest.raises(InputError, match="known are scan, grid, match"):
        Config().with_settings({"colour": "red"})
    with pytest.raises(InputError, match=r"'loops' is .*; give a LoopConfig"):
        Config(loops=Config().scan)


def test_numbers_of_numpy_are_numbers():
    config = Config().with_settings({"scan.max_range_m": np.float32(8.0), "match.iterations": np.int64(7)})
    assert (type(config.scan.max_range_m), type(config.match.iterations)) == (float, int)


def test_the_reach_that_the_settings_allow_is_that_of_the_grid():
    assert _kernels.REACH == REACH_CELLS


@pytest.mark.parametrize(
    "text",
    [
        "[scan]\nmin_range_m = 0",
        "[scan]\nsurface_gap = 1",
        "[grid]\ninsert_every_m = 0.0",
        "[motion]\nhypotheses = 0",
        "[match]\nmin_score = 1.0",
        "[match]\nmin_score = 0.0",
        "[loops]\nmin_agreement = 1.0",
        "[loops]\nconfirm_after_m = 0.0",
    ],
)
def test_zeros_and_whole_shares_that_mean_something_are_taken(tmp_path, text):
    path = tmp_path / "c.toml"
    path.write_text(text + "\n")
    block, key, value = text[1:].replace("]\n", " ").replace("= ", "").split()
    assert getattr(getattr(read_toml(path), block), key) == float(value)


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.toml.*can't be read"):
        read_toml(tmp_path / "nothing.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match=r"binary\.toml.*is not"):
        read_toml(tmp_path / "binary.toml")
