"""Figures of experiments: what is too long is red, too short blue, and the same drawing gives the same bytes."""

import numpy as np
from PIL import Image

from mapmend.lab.method_figures import EdgePanel, TitledPath, draw_edges, draw_maps, draw_paths
from mapmend.maps import FREE, OCCUPIED, OccupancyMap
from mapmend.view.figures import MapPanel

ROUND = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0], [0.0, 5.0], [0.0, 0.5]])
ROUND_POSES = np.column_stack((ROUND, np.zeros(len(ROUND))))


def drawn(draw, folder, name):
    """The picture as an array, after checking that a second drawing has the same bytes."""
    draw(folder / name)
    draw(folder / f"again-{name}")
    assert (folder / name).read_bytes() == (folder / f"again-{name}").read_bytes()
    with Image.open(folder / name) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def count_of(picture, colour):
    return int((np.abs(picture - np.array(colour)).max(axis=2) < 12).sum())


def test_edges_have_the_colour_of_what_they_are_off_by(tmp_path):
    red, blue = (201, 42, 42), (24, 100, 171)

    def picture(off):
        panels = [EdgePanel("before", ROUND, np.full(4, off)), EdgePanel("after", ROUND, np.zeros(4))]
        return drawn(lambda path: draw_edges(panels, path), tmp_path, f"edges{off}.png")

    long, short = picture(0.9), picture(-0.9)
    # The bar beside shows both colours; the edges add to one of them.
    assert count_of(long, red) > 2 * count_of(short, red)
    assert count_of(short, blue) > 2 * count_of(long, blue)


def test_every_path_has_its_colour(tmp_path):
    paths = [TitledPath("odometry", ROUND + 1.0), TitledPath("go", ROUND + 0.5), TitledPath("igo", ROUND)]
    picture = drawn(lambda path: draw_paths(TitledPath("truth", ROUND), paths, path), tmp_path, "paths.png")
    assert all(count_of(picture, colour) > 100 for colour in ((173, 181, 189), (232, 89, 12), (43, 138, 62)))


def test_a_map_stands_where_its_panel_puts_it(tmp_path):
    image = np.full((40, 40), FREE, np.uint8)
    image[:, :8] = OCCUPIED
    grid = OccupancyMap(image, 0.25, (0.0, 0.0, 0.0))

    def wall_columns(T_world_map):
        moved = MapPanel("moved", grid, ROUND_POSES, np.array(T_world_map))
        panels = [moved, MapPanel("as it is", grid, ROUND_POSES, np.zeros(3))]
        picture = drawn(lambda path: draw_maps(panels, path), tmp_path, "maps.png")
        left = picture[:, : picture.shape[1] // 2]
        dark = np.abs(left - np.array((33, 37, 41))).max(axis=2) < 12
        return np.flatnonzero(dark.sum(axis=0) > 50).mean() / left.shape[1]

    assert wall_columns((10.0, 0.0, 0.0)) > wall_columns((0.0, 0.0, 0.0)) + 0.2
