"""``compare.png``: the maps of several methods side by side, to one scale."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from mapmend.maps import UNKNOWN, OccupancyMap
from mapmend.view.figures import ESTIMATE, draw_grid, finish_axes, new_figure, save_figure

Float = NDArray[np.float64]

ACROSS, SIDE = 3, 6.5
MARGIN_M = 1.0
MOST_TIMES = 1.4
"""No panel is wider or higher than this many times the smallest map: a lost map is cut off."""
HERE = np.zeros(3)


@dataclass(frozen=True)
class ComparedMap:
    """A map to show, with the trajectory ``poses`` (n, 3); the frames of all begin at the robot's first pose."""

    title: str
    grid: OccupancyMap
    poses: Float


def draw_compared_maps(maps: list[ComparedMap], path: str | Path | IO[bytes]) -> None:
    """All maps on the same axes, at most three in a row, as a PNG."""
    low, high = _window(maps)
    rows = math.ceil(len(maps) / ACROSS)
    columns = math.ceil(len(maps) / rows)
    width_m, height_m = (high - low).tolist()
    figure = new_figure(columns, width_m, height_m, rows, SIDE)
    axes = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for axis, shown in zip(axes, maps, strict=False):
        draw_grid(axis, shown.grid, HERE)
        axis.plot(shown.poses[:, 0], shown.poses[:, 1], color=ESTIMATE, linewidth=0.7)
        finish_axes(axis, shown.title, low, high)
    for axis in axes[len(maps) :]:
        axis.set_visible(False)
    for axis in axes[::columns]:
        axis.set_ylabel("y [m]")
    save_figure(figure, path)


def _window(maps: list[ComparedMap]) -> tuple[Float, Float]:
    """The area of all panels: the known cells of all maps, as far as `MOST_TIMES` allows."""
    boxes = [_known(shown.grid) for shown in maps]
    smallest = min(boxes, key=lambda box: float(np.prod(box[1] - box[0])))
    room = 0.5 * (MOST_TIMES - 1.0) * (smallest[1] - smallest[0])
    low = np.maximum(np.min([box[0] for box in boxes], axis=0), smallest[0] - room)
    high = np.minimum(np.max([box[1] for box in boxes], axis=0), smallest[1] + room)
    return low - MARGIN_M, high + MARGIN_M


def _known(grid: OccupancyMap) -> tuple[Float, Float]:
    """The corners of a map's known area, m, without half a percent of its cells on each side, which long beams
    clear."""
    rows, columns = np.nonzero(grid.image != UNKNOWN)
    if not len(rows):
        return np.zeros(2), np.ones(2)
    low = np.array([np.quantile(columns, 0.005), np.quantile(rows, 0.005)])
    high = np.array([np.quantile(columns, 0.995), np.quantile(rows, 0.995)]) + 1.0
    corner = np.array(grid.origin[:2])
    return corner + low * grid.resolution_m, corner + high * grid.resolution_m
