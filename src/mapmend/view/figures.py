"""Pictures with axes, drawn by matplotlib: a simulated world, and maps beside the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmend.maps import FREE, OCCUPIED, OccupancyMap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Float = NDArray[np.float64]

WALL, FREE_COLOUR, UNKNOWN_COLOUR = "#212529", "#ffffff", "#dee2e6"
TRUE_PATH, ESTIMATE = "#2b8a3e", "#1565c0"
MARGIN_M = 1.0


@dataclass(frozen=True)
class MapPanel:
    """A map to show: ``poses`` (n, 3) and ``grid`` in the map's frame, whose pose is ``T_world_map`` (3,)."""

    title: str
    grid: OccupancyMap
    poses: Float
    T_world_map: Float


def new_figure(panels: int, width_m: float, height_m: float, rows: int = 1, side: float = 4.6) -> Figure:
    """A figure for ``rows`` rows of ``panels`` drawings of width_m x height_m side by side, without a window.

    ``side``: how wide each is, in inches.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    aspect = min(max(height_m / width_m, 0.4), 2.5)
    figure = Figure(figsize=(panels * side, rows * (side * aspect + 0.9)), layout="compressed")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path | IO[bytes]) -> None:
    """Writes a PNG to a file or stream, without date and program version: the same drawing gives the same bytes."""
    figure.savefig(path, dpi=110, bbox_inches="tight", pad_inches=0.15, metadata={"Software": None})


def draw_world(walls: Float, truth: Float, path: str | Path, title: str) -> None:
    """A world's walls, (n, 4), with the robot's true path, (n, 3), as a PNG."""
    low, high = _bounds(walls)
    figure = new_figure(1, *(high - low))
    axes = figure.subplots()
    _draw_truth(axes, walls, truth)
    finish_axes(axes, title, low, high)
    axes.set_ylabel("y [m]")
    save_figure(figure, path)


def draw_comparison(walls: Float, truth: Float, maps: list[MapPanel], path: str | Path) -> None:
    """The truth, then each map in the world's frame with the true path over it, all on the same axes, as a PNG."""
    low, high = _bounds(walls)
    for panel in maps:
        # A bad map may make all panels larger, but a lost one must not make them unreadable.
        places = _in_world(panel.poses[:, :2], panel.T_world_map)
        size = high - low
        low = np.maximum(np.minimum(low, places.min(axis=0) - MARGIN_M), low - size)
        high = np.minimum(np.maximum(high, places.max(axis=0) + MARGIN_M), high + size)
    figure = new_figure(len(maps) + 1, *(high - low))
    first, *others = figure.subplots(1, len(maps) + 1, sharex=True, sharey=True)
    _draw_truth(first, walls, truth)
    finish_axes(first, "truth", low, high)
    first.set_ylabel("y [m]")
    for axes, panel in zip(others, maps, strict=True):
        draw_grid(axes, panel.grid, panel.T_world_map)
        axes.plot(truth[:, 0], truth[:, 1], "--", color=TRUE_PATH, linewidth=1.2, label="true path")
        path_xy = _in_world(panel.poses[:, :2], panel.T_world_map)
        axes.plot(path_xy[:, 0], path_xy[:, 1], color=ESTIMATE, linewidth=1.2, label="estimated path")
        finish_axes(axes, panel.title, low, high)
    if others:
        others[0].legend(loc="center", framealpha=1.0)
    save_figure(figure, path)


def _draw_truth(axes: Axes, walls: Float, truth: Float) -> None:
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(list(walls.reshape(-1, 2, 2)), colors=WALL, linewidths=1.4))
    axes.plot(truth[:, 0], truth[:, 1], "--", color=TRUE_PATH, linewidth=1.2)
    axes.plot(truth[0, 0], truth[0, 1], "o", color=TRUE_PATH, markersize=6)


def draw_grid(axes: Axes, grid: OccupancyMap, T_world_map: Float) -> None:
    """A map's cells, drawn at ``T_world_map`` (3,)."""
    from matplotlib.colors import to_rgb
    from matplotlib.transforms import Affine2D

    palette = np.tile(np.array(to_rgb(UNKNOWN_COLOUR)), (256, 1))
    palette[FREE], palette[OCCUPIED] = to_rgb(FREE_COLOUR), to_rgb(WALL)
    rows, columns = grid.image.shape
    x, y, _ = grid.origin
    size = grid.resolution_m
    picture = axes.imshow(
        palette[grid.image],
        origin="lower",
        extent=(x, x + columns * size, y, y + rows * size),
        interpolation="nearest",
        zorder=0,
    )
    placed = Affine2D().rotate(float(T_world_map[2])).translate(float(T_world_map[0]), float(T_world_map[1]))
    picture.set_transform(placed + axes.transData)
    axes.set_facecolor(UNKNOWN_COLOUR)


def finish_axes(axes: Axes, title: str, low: Float, high: Float) -> None:
    """Title, equal scales, and the corners ``low`` and ``high`` (2,) of the area shown, m."""
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_xlabel("x [m]")
    axes.set_title(title)


def _bounds(walls: Float) -> tuple[Float, Float]:
    ends = walls.reshape(-1, 2)
    return ends.min(axis=0) - MARGIN_M, ends.max(axis=0) + MARGIN_M


def _in_world(points: Float, T_world_map: Float) -> Float:
    from mapmend.geometry.se2 import transform_points

    return transform_points(T_world_map, points)
