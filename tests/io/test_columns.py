"""Trajectories and relations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mapmend.errors import InputError, MapmendError
from mapmend.io.relations import parse_relations, read_relations
from mapmend.io.tum import parse_tum, read_tum, stamp_text, write_tum
from tests.real_data import data_path

_rows = st.lists(
    st.tuples(st.floats(0.0, 2e9), st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-3.14, 3.14)), min_size=1
)


@settings(max_examples=50, deadline=None)
@given(_rows)
def test_written_trajectory_reads_back_the_same(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("tum") / "t.tum"
    values = np.array(rows)
    write_tum(path, values[:, 0], values[:, 1:])
    back = read_tum(path)
    np.testing.assert_array_equal(back.stamps_s, values[:, 0])
    np.testing.assert_array_equal(back.poses[:, :2], values[:, 1:3])
    np.testing.assert_allclose(back.poses[:, 2], values[:, 3], atol=1e-14)


def test_stamps_have_six_decimals_or_more():
    assert stamp_text(976052857.337284) == "976052857.337284"
    assert stamp_text(5.0) == "5.000000"
    assert stamp_text(0.12345678) == "0.12345678"


def test_trajectory_shapes_are_checked(tmp_path):
    with pytest.raises(MapmendError, match=r"\(n, 3\)"):
        write_tum(tmp_path / "t.tum", np.zeros(2), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("# only\n", None),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n", 2),
        ("1 0 0 0 0 0 0 1\n\n2 x 0 0 0 0 0 1\n", 3),
        ("1 nan 0 0 0 0 0 1\n", 1),
        ("1 0 0 0 0 0 0 0\n", 1),
        ("1 1e300 0 0 0 0 0 1\n", 1),
    ],
)
def test_bad_trajectory_is_refused_with_its_line(text, line):
    with pytest.raises(InputError) as caught:
        parse_tum(text.encode(), "t.tum")
    assert caught.value.line == line


def test_relations_are_read_without_their_heights():
    relations = parse_relations(b"# t1 t2\n1.5 2.5 0.1 0.2 9 9 9 -0.3\n", "r")
    assert (relations.t1_s[0], relations.t2_s[0], len(relations)) == (1.5, 2.5, 1)
    assert relations.relative_poses.tolist() == [[0.1, 0.2, -0.3]]


@pytest.mark.parametrize(("name", "count"), [("intel", 2984), ("fr079", 1685)])
def test_real_relations(name, count):
    assert len(read_relations(data_path(f"relations/{name}.relations"))) == count
