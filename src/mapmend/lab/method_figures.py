"""Figures of an experiment, drawn by matplotlib: trajectories over each other, and edges coloured by their error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mapmend.geometry.se2 import transform_points
from mapmend.maps import OccupancyMap
from mapmend.view.figures import ESTIMATE, TRUE_PATH, MapPanel, draw_grid, finish_axes, new_figure, save_figure

Float = NDArray[np.float64]

MARGIN_M = 1.0
MOST_OFF_SHARE = 0.5
"""Edges with an error of this share of their length, or more, have the full colour."""

LINES = ("#adb5bd", "#e8590c", "#1565c0", "#862e9c")


@dataclass(frozen=True)
class TitledPath:
    """A trajectory to show, ``xy_m`` (n, 2) in the truth's frame."""

    title: str
    xy_m: Float


@dataclass(frozen=True)
class EdgePanel:
    """Edges between neighbouring nodes at ``xy_m`` (n, 2), each too long by ``off_share`` (n - 1,) of its length."""

    title: str
    xy_m: Float
    off_share: Float


def draw_maps(maps: Sequence[MapPanel], path: str | Path) -> None:
    """Maps side by side in the frame that their panels name, each with its trajectory, as a PNG (IGO Figure 5)."""
    corners = np.concatenate([transform_points(panel.T_world_map, _corners(panel.grid)) for panel in maps])
    low, high = corners.min(axis=0), corners.max(axis=0)
    figure = new_figure(len(maps), *(high - low))
    all_axes = np.atleast_1d(figure.subplots(1, len(maps), sharex=True, sharey=True))
    for axes, panel in zip(all_axes, maps, strict=True):
        draw_grid(axes, panel.grid, panel.T_world_map)
        axes.plot(*transform_points(panel.T_world_map, panel.poses[:, :2]).T, color=ESTIMATE, linewidth=0.5)
        finish_axes(axes, panel.title, low, high)
    save_figure(figure, path)


def draw_paths(truth: TitledPath, paths: Sequence[TitledPath], path: str | Path) -> None:
    """All trajectories on one pair of axes, the true one dashed on top, as a PNG (IGO Figure 6)."""
    everything = np.concatenate([truth.xy_m, *(one.xy_m for one in paths)])
    low, high = everything.min(axis=0) - MARGIN_M, everything.max(axis=0) + MARGIN_M
    figure = new_figure(1, *(high - low))
    axes = figure.subplots()
    for one, colour in zip(paths, LINES, strict=False):
        axes.plot(*one.xy_m.T, color=colour, linewidth=1.4, label=one.title)
    axes.plot(*truth.xy_m.T, "--", color=TRUE_PATH, linewidth=1.4, label=truth.title)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="best", framealpha=0.9, fontsize="small")
    save_figure(figure, path)


def draw_edges(panels: Sequence[EdgePanel], path: str | Path) -> None:
    """Each panel's trajectory with its edges coloured, red where they are too long and blue where too short: a PNG."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    colours = LinearSegmentedColormap.from_list("off", ["#1864ab", "#4dabf7", "#ced4da", "#ff8787", "#c92a2a"])
    norm = Normalize(-MOST_OFF_SHARE, MOST_OFF_SHARE)
    everything = np.concatenate([panel.xy_m for panel in panels])
    low, high = everything.min(axis=0) - MARGIN_M, everything.max(axis=0) + MARGIN_M
    figure = new_figure(len(panels), *(high - low))
    all_axes = np.atleast_1d(figure.subplots(1, len(panels), sharex=True, sharey=True))
    for axes, panel in zip(all_axes, panels, strict=True):
        ends = np.stack((panel.xy_m[:-1], panel.xy_m[1:]), axis=1)
        # The edges with the largest errors are drawn last, on top.
        order = np.argsort(np.abs(panel.off_share), kind="stable")
        lines = LineCollection(list(ends[order]), cmap=colours, norm=norm, linewidths=2.2, capstyle="round")
        lines.set_array(panel.off_share[order])
        axes.add_collection(lines)
        finish_axes(axes, panel.title, low, high)
    all_axes[0].set_ylabel("y [m]")
    bar = figure.colorbar(ScalarMappable(norm, colours), ax=list(all_axes), shrink=0.7, extend="both")
    bar.set_label("edge too long by (share of its length)")
    save_figure(figure, path)


def _corners(grid: OccupancyMap) -> Float:
    rows, columns = grid.image.shape
    x, y, size = grid.origin[0], grid.origin[1], grid.resolution_m
    return np.array([[x + i * columns * size, y + j * rows * size] for i in (0, 1) for j in (0, 1)])
