"""tune.png: M over phi with its minimum, and the map with phi = 1 beside that with phi*."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mapmend.graph.pose_graph import PoseGraph
from mapmend.tuning.tune import PUBLISHED_PHI, TuneResult
from mapmend.view.check_picture import LOOP, MARGIN_M, MOST_POINTS, PATH, POINT
from mapmend.view.figures import save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Float = NDArray[np.float64]

CURVE, BEST, OFF = "#1565c0", "#e03131", "#9c36b5"
ZOOM = 0.1
"""The second curve shows values up to this share above the least M."""


def tune_png(result: TuneResult, name: str) -> bytes:
    """The picture of a tuned graph, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    span = np.ptp(result.check.views.points_in_map(), axis=0)
    aspect = min(max(float(span[1] / max(span[0], 1e-9)), 0.4), 2.0) if span.any() else 1.0
    figure = Figure(figsize=(13.0, 4.0 + 6.0 * aspect), layout="constrained")
    FigureCanvasAgg(figure)
    (whole, near), (published, tuned) = figure.subplots(2, 2, height_ratios=(3.0, 6.0 * aspect))
    phi = f"{'phi*' if result.phi == result.least_phi else 'phi'} = {result.phi:.4g}"
    verdict = "consistent" if result.consistent else "no phi gives a consistent map"
    figure.suptitle(f"{name}: {result.kernel}, {phi}; {verdict}, p = {result.check.p_value:.2g}")
    _draw_curve(whole, result, None)
    _draw_curve(near, result, ZOOM)
    views = result.check.views
    other = views.scans.placed(result.published.poses).points_in_map()
    at_published = result.measure_at(PUBLISHED_PHI)
    title = f"phi = {PUBLISHED_PHI:g}" + ("" if at_published is None else f": M = {at_published:.4g} m")
    _draw_map(published, result.published, other, np.zeros(0, np.int64), title)
    title = f"{phi}: M = {result.measure_m:.4g} m, {len(result.switched_off)} loops off"
    _draw_map(tuned, result.graph, views.points_in_map(), result.switched_off, title)
    tuned.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    stream = BytesIO()
    save_figure(figure, stream)
    return stream.getvalue()


def _draw_curve(axes: Axes, result: TuneResult, zoom: float | None) -> None:
    """M over sqrt(phi), as in MC Figure 4; with ``zoom`` only values up to that share above the least.

    The line marks the map shown; a dotted line marks the least M if this is another map.
    """
    roots = np.sqrt(result.curve_phi)
    axes.plot(roots, result.curve_m, ".-", color=CURVE, linewidth=1.0, markersize=4)
    if result.least_phi != result.phi:
        axes.axvline(float(np.sqrt(result.least_phi)), color=BEST, linewidth=1.0, linestyle=":")
    axes.axvline(float(np.sqrt(result.phi)), color=BEST, linewidth=1.2)
    axes.set(xlabel="root of phi", ylabel="M(phi) [m a pair]")
    least = float(result.curve_m.min())
    if zoom is None:
        axes.set(title="how far scans contradict each other", ylim=(0.0, None))
    elif least > 0.0:
        shown = roots[result.curve_m <= (1.0 + zoom) * least]
        margin = max(0.1 * float(np.ptp(shown)), 0.02)
        axes.set(title=f"the same, up to {zoom:.0%} above the least")
        axes.set(ylim=((1.0 - 0.1 * zoom) * least, (1.0 + zoom) * least))
        axes.set(xlim=(float(shown.min()) - margin, float(shown.max()) + margin))


def _draw_map(axes: Axes, graph: PoseGraph, points: Float, off: NDArray[np.int64], title: str) -> None:
    places = np.concatenate((points, graph.poses[:, :2]))
    low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    axes.plot(*points[:: max(1, len(points) // MOST_POINTS)].T, ",", color=POINT)
    axes.plot(*graph.poses[:, :2].T, "-", color=PATH, linewidth=0.8, label="trajectory")
    is_off = np.zeros(len(graph.edges), np.bool_)
    is_off[off] = True
    for rows, colour, label in ((graph.is_loop & ~is_off, LOOP, "loop edge"), (is_off, OFF, "switched off")):
        ends = graph.poses[graph.edges[rows]][:, :, :2]
        broken = np.concatenate((ends, np.full((len(ends), 1, 2), np.nan)), axis=1).reshape(-1, 2)
        if len(broken):
            axes.plot(broken[:, 0], broken[:, 1], "-", color=colour, linewidth=0.6, label=label)
    axes.set(
        xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title
    )
