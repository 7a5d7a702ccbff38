import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from mapmend.errors import InputError, MapmendError
from mapmend.io.nav2 import parse_pgm, read_map, read_pgm, write_map
from mapmend.maps import FREE, OCCUPIED, UNKNOWN, OccupancyMap

_images = arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=12))


@settings(max_examples=50, deadline=None)
@given(_images, st.floats(0.01, 1.0), st.tuples(*[st.floats(-100, 100)] * 3))
def test_written_map_reads_back_the_same(tmp_path_factory, image, resolution, origin):
    folder = tmp_path_factory.mktemp("map")
    write_map(folder, OccupancyMap(image, resolution, origin))
    back = read_map(folder / "map.yaml")
    np.testing.assert_array_equal(back.image, image)
    assert (back.resolution_m, back.origin) == (resolution, origin)


def test_picture_has_the_lowest_row_at_its_foot(tmp_path):
    image = np.array([[OCCUPIED, OCCUPIED], [FREE, UNKNOWN]], np.uint8)
    write_map(tmp_path, OccupancyMap(image, 0.05, (-1.0, 2.0, 0.0)))
    assert (tmp_path / "map.pgm").read_bytes() == b"P5\n2 2\n255\n" + bytes([FREE, UNKNOWN, OCCUPIED, OCCUPIED])
    assert (tmp_path / "map.yaml").read_text().splitlines() == [
        "image: map.pgm", "mode: trinary", "resolution: 0.05", "origin: [-1.0, 2.0, 0.0]", "negate: 0",
        "occupied_thresh: 0.65", "free_thresh: 0.196",
    ]  # fmt: skip


def test_plain_picture_with_comments():
    picture = parse_pgm(b"P2 # made by hand\n# and again\n3 2\n255\n0 1 2 # row\n253 254 255\n", "p")
    assert picture.tolist() == [[0, 1, 2], [253, 254, 255]]
    assert parse_pgm(b"P5\n# c\n2 1\n#c\n255\n\x20\x0a", "p").tolist() == [[32, 10]]


def test_pages_of_other_programs_are_read(tmp_path):
    (tmp_path / "m.pgm").write_bytes(b"P5 1 1 255\n\x00")
    (tmp_path / "m.yaml").write_text('image: "m.pgm"\nresolution: 0.1 # m\norigin:\n- -1\n- 2\n- 0\nnegate: 1\n')
    grid = read_map(tmp_path / "m.yaml")
    assert grid.origin == (-1.0, 2.0, 0.0)
    assert grid.image.tolist() == [[255]]


@pytest.mark.parametrize(
    "data", [b"", b"P6\n1 1\n255\n000", b"P5\n2 2\n255\n\x00", b"P5\n", b"P5\n99999 99999\n255\n", b"P2\n1 1\n255\nx",
             b"P5\n1 1\n65535\n00", b"P5\n0 4\n255\n", b"P2\n1 1\n255\n256"],
)  # fmt: skip
def test_bad_picture_is_refused(data):
    with pytest.raises(InputError):
        parse_pgm(data, "p.pgm")


@pytest.mark.parametrize(
    "page", ["resolution: 0.05\n", "image: m.pgm\n", "image: m.pgm\nresolution: x\n", "image: m.pgm\nresolution: 0\n",
             "image: m.pgm\nresolution: 0.05\norigin: [1]\n", "image: other.pgm\nresolution: 0.05\n"],
)  # fmt: skip
def test_bad_page_is_refused(tmp_path, page):
    (tmp_path / "m.pgm").write_bytes(b"P5 1 1 255\n\x00")
    (tmp_path / "m.yaml").write_text(page)
    with pytest.raises(InputError):
        read_map(tmp_path / "m.yaml")


def test_image_is_checked(tmp_path):
    with pytest.raises(MapmendError, match="uint8"):
        OccupancyMap(np.zeros((2, 2)), 0.05)
    with pytest.raises(InputError, match="no such file"):
        read_pgm(tmp_path / "none.pgm")
