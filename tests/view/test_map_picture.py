"""The picture of a map: its size, its colours, and where metres land in it."""

import numpy as np
import pytest

from mapmend.maps import FREE, OCCUPIED, UNKNOWN, OccupancyMap
from mapmend.view.map_picture import (
    FREE_COLOUR,
    MOST_PIXELS,
    OCCUPIED_COLOUR,
    START,
    STRIP_PIXELS,
    TRAJECTORY,
    Overlay,
    draw_map,
)

NOTHING = Overlay(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2, 2)))


def a_map(rows, columns, origin=(0.0, 0.0, 0.0)):
    image = np.full((rows, columns), UNKNOWN, np.uint8)
    image[1:-1, 1:-1] = FREE
    image[1, 1:-1] = OCCUPIED
    return OccupancyMap(image, 0.05, origin)


@pytest.mark.parametrize("shape", [(3, 3), (20, 700), (700, 20), (900, 1500), (1700, 3000), (300, 9000)])
def test_sizes(shape):
    picture = draw_map(a_map(*shape), NOTHING, "title")
    assert max(picture.size) <= MOST_PIXELS
    assert picture.height > STRIP_PIXELS


def test_up_is_up_and_metres_land_where_they_belong():
    grid = a_map(400, 800, (-10.0, -5.0, 0.0))
    overlay = Overlay(np.array([[-5.0, 0.0], [20.0, 0.0]]), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    picture = draw_map(grid, overlay)
    scale = (picture.height - STRIP_PIXELS) / 400
    at = lambda x, y: picture.getpixel((int((x + 10.0) / 0.05 * scale), int((15.0 - y) / 0.05 * scale)))  # noqa: E731
    assert at(-5.0, 0.0) == START
    assert at(5.0, 0.0) == TRAJECTORY
    assert at(5.0, 5.0) == FREE_COLOUR
    assert at(5.0, -4.92) == OCCUPIED_COLOUR


def test_a_wall_of_one_cell_survives_shrinking():
    grid = a_map(5000, 9000)
    grid.image[2500, :] = OCCUPIED
    picture = draw_map(grid, NOTHING)
    middle = np.asarray(picture)[: picture.height - STRIP_PIXELS, picture.width // 2]
    dark = np.flatnonzero((middle == OCCUPIED_COLOUR).all(axis=1))
    assert np.any(np.abs(dark - (picture.height - STRIP_PIXELS) / 2) < 3)


def test_many_poses_at_one_place_and_loops():
    overlay = Overlay(np.full((10_000, 2), 2.0), np.array([[2.0, 2.0]]), np.array([[[1.0, 1.0], [3.0, 3.0]]]))
    assert draw_map(a_map(100, 100), overlay, "x" * 300).size[0] > 100
