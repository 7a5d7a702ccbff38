"""check.png: the map, the contradicting points in red, and the suspect loop edges."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mapmend.consistency.check import CheckResult
from mapmend.graph.pose_graph import PoseGraph
from mapmend.view.figures import new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Float = NDArray[np.float64]

POINT, PATH, LOOP = "#495057", "#a5d8ff", "#74c0fc"
WRONG_POINT, FAILED_SCAN, SUSPECT = "#e03131", "#f08c00", "#9c36b5"
MOST_SUSPECTS, MOST_REGIONS = 3, 5
MOST_POINTS = 400_000
"""If there are more end points, only some are drawn: a picture cannot show more."""

MARGIN_M = 1.0


def check_png(graph: PoseGraph, result: CheckResult, title: str) -> bytes:
    """The picture of a checked graph, as a PNG."""
    points = result.views.points_in_map()
    places = np.concatenate((points, graph.poses[:, :2]))
    low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    figure = new_figure(1, float(high[0] - low[0]), float(high[1] - low[1]))
    width, height = figure.get_size_inches()
    figure.set_size_inches(2.0 * width, 2.0 * height)
    axes = figure.subplots()
    thinned = points[:: max(1, len(points) // MOST_POINTS)]
    axes.plot(*thinned.T, ",", color=POINT)
    axes.plot(*graph.poses[:, :2].T, "-", color=PATH, linewidth=0.8, label="trajectory")
    _draw_lines(axes, graph, np.flatnonzero(graph.is_loop), {"color": LOOP, "linewidth": 0.6, "label": "loop edge"})
    if not result.consistent:
        _draw_wrong(axes, graph, result, points)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title
    )
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    stream = BytesIO()
    save_figure(figure, stream)
    return stream.getvalue()


def _draw_wrong(axes: Axes, graph: PoseGraph, result: CheckResult, points: Float) -> None:
    """The evidence against the map: failed scans, contradicting points, suspect loops, the worst regions' numbers."""
    failed = graph.poses[result.scans.failed]
    axes.plot(failed[:, 0], failed[:, 1], ".", color=FAILED_SCAN, markersize=4, label="failed scan")
    wrong = points[result.points]
    axes.plot(wrong[:, 0], wrong[:, 1], ".", color=WRONG_POINT, markersize=1.5, label="contradicting point")
    shown = result.suspects[result.against > 0.0][:MOST_SUSPECTS]
    _draw_lines(axes, graph, shown, {"color": SUSPECT, "linewidth": 2.2, "marker": "o", "label": "suspect loop edge"})
    for number, region in enumerate(result.regions[:MOST_REGIONS], start=1):
        box = {"boxstyle": "circle", "facecolor": "white", "edgecolor": WRONG_POINT}
        axes.annotate(str(number), region.place_m, color=WRONG_POINT, ha="center", va="center", bbox=box)


def _draw_lines(axes: Axes, graph: PoseGraph, edges: NDArray[np.int64], style: dict[str, Any]) -> None:
    """Edges, rows (k,), as one line that breaks between them."""
    ends = graph.poses[graph.edges[edges]][:, :, :2]
    broken = np.concatenate((ends, np.full((len(ends), 1, 2), np.nan)), axis=1).reshape(-1, 2)
    if len(broken):
        axes.plot(broken[:, 0], broken[:, 1], "-", **style)
