"""The picture of several maps."""

import io

import numpy as np
import pytest
from PIL import Image

from mapmend.view.compare_picture import MARGIN_M, MOST_TIMES, ComparedMap, _window, draw_compared_maps
from tests.view.test_map_picture import a_map

PATH = np.zeros((5, 3))


@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_any_number_of_maps_is_drawn(count):
    maps = [ComparedMap(f"map {k}", a_map(60 + 10 * k, 100), PATH) for k in range(count)]
    stream = io.BytesIO()
    draw_compared_maps(maps, stream)
    assert Image.open(stream).size[0] > 300


def test_a_map_that_went_astray_leaves_the_others_readable():
    near, astray = a_map(200, 400), a_map(200, 4000, (-100.0, 0.0, 0.0))
    low, high = _window([ComparedMap("near", near, PATH), ComparedMap("astray", astray, PATH)])
    known = np.array([400 - 2, 200 - 2]) * near.resolution_m
    assert (high - low <= MOST_TIMES * known + 2 * MARGIN_M + 0.1).all()
    assert low[0] < 0.0
    assert high[0] > 400 * near.resolution_m


def test_a_map_that_knows_nothing_is_a_map():
    grid = a_map(10, 10)
    grid.image[:] = 205
    draw_compared_maps([ComparedMap("empty", grid, PATH)], io.BytesIO())
