"""``mapmend check``: whether a map is consistent, and where not."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from mapmend.commands.console import ProgressBar, print_json, say, say_notes, table, thread_count, told_compiling
from mapmend.config import Config, read_toml
from mapmend.consistency.check import CheckResult, check
from mapmend.datasets.cache import named_file
from mapmend.errors import InputError, MapmendError, OutputError
from mapmend.graph.pose_graph import PoseGraph
from mapmend.io.info import describe_content
from mapmend.io.output import check_file_writable, write_whole
from mapmend.io.reader import read, read_run

INCONSISTENT = 1
PICTURE = "check.png"
MOST_REGIONS, MOST_SUSPECTS, MOST_SCANS = 5, 3, 4
"""So many of each are listed for people; JSON has them all."""


def run(options: Namespace) -> int:
    """Checks ``options.graph``; 0 where it is consistent, 1 where not."""
    config = (read_toml(options.config) if options.config else Config()).consistency
    graph = load_graph(options.graph)
    picture = _folder(options) / PICTURE
    check_file_writable(picture)
    try:
        with ProgressBar() as progress, told_compiling():
            result = check(graph, config, threads=thread_count(options.threads), progress=progress)
    except MapmendError as error:
        raise InputError(options.graph, str(error), "name a graph whose nodes carry their scans") from error
    say_notes(graph.notes)
    for note in result.notes:
        say(f"note: {note}")
    write_whole(picture, _picture(graph, result, options.graph))
    page = report(graph, result)
    if options.json:
        print_json({**page, "picture": str(picture)})
    else:
        print("\n".join(lines(page, picture)))
    return 0 if result.consistent else INCONSISTENT


def load_graph(path: str) -> PoseGraph:
    """The graph in a RUN folder or a file; raises InputError, saying what is there instead."""
    if Path(path).is_dir():
        graph = read_run(path)[1]
        if graph is None:
            raise InputError(path, "the RUN holds no graph.g2o", "map the log again")
        return graph
    content = read(named_file(path))
    if not isinstance(content, PoseGraph):
        kind = describe_content(content).kind
        raise InputError(path, f"holds no pose graph but a {kind}", "name a RUN, or a g2o or TORO graph with scans")
    return content


def report(graph: PoseGraph, result: CheckResult) -> dict[str, Any]:
    """What ``--json`` prints; nodes by their ids."""
    return {
        "consistent": result.consistent,
        "p_value": result.p_value,
        "scans": int(np.count_nonzero(np.diff(result.views.scans.corner_offsets))),
        "scans_tested": int(np.count_nonzero(result.scans.tested)),
        "scans_inconsistent": int(np.count_nonzero(result.scans.failed)),
        "pairs": len(result.pairs.pairs),
        "pairs_overlapping": result.overlapping,
        "pairs_failed": int(np.count_nonzero(result.pairs.failed)),
        "suspect_edges": [
            {**_edge(graph, edge), "against": round(float(against), 3)}
            for edge, against in zip(result.suspects, result.against, strict=True)
            if against > 0.0
        ],
        "regions": [
            {
                "x_m": round(region.place_m[0], 2),
                "y_m": round(region.place_m[1], 2),
                "size_m": round(region.size_m, 2),
                "pairs_failed": region.failures,
                "scans": graph.ids[region.scans].tolist(),
                "loop_edges": [_edge(graph, edge) for edge in region.loops],
            }
            for region in result.regions
        ],
        "inconsistent_scans": graph.ids[result.scans.failed].tolist(),
        "notes": [*map(str, graph.notes), *result.notes],
    }


def lines(page: dict[str, Any], picture: Path) -> list[str]:
    """The report for people."""
    verdict = "consistent" if page["consistent"] else "INCONSISTENT"
    text = [
        f"the map is {verdict}: p = {page['p_value']:.3g}",
        f"  scans: {page['scans_inconsistent']} of {page['scans_tested']} contradict the others",
        f"  pairs: {page['pairs_failed']} of {page['pairs']} failed ({page['pairs_overlapping']} overlap)",
    ]
    regions = page["regions"][:MOST_REGIONS]
    if regions:
        rows = [_region_row(number, region) for number, region in enumerate(regions, start=1)]
        text += ["", table(("region", "x [m]", "y [m]", "size [m]", "pairs", "scans", "which", "loop edges"), rows)]
        rest = len(page["regions"]) - len(regions)
        text += [f"and {rest} smaller one{'s' * (rest != 1)}"] if rest else []
    if page["suspect_edges"] and not page["consistent"]:
        suspects = [f"{edge['from']} -> {edge['to']}" for edge in page["suspect_edges"][:MOST_SUSPECTS]]
        text += ["", f"most suspect loop edges: {', '.join(suspects)}"]
    return [*text, f"picture: {picture}"]


def _region_row(number: int, region: dict[str, Any]) -> tuple[str, ...]:
    scans, loops = region["scans"], [f"{edge['from']}-{edge['to']}" for edge in region["loop_edges"]]
    return (
        str(number),
        f"{region['x_m']:.1f}",
        f"{region['y_m']:.1f}",
        f"{region['size_m']:.1f}",
        str(region["pairs_failed"]),
        str(len(scans)),
        _some([str(scan) for scan in scans], MOST_SCANS),
        _some(loops, MOST_SUSPECTS) or "none",
    )


def _some(names: list[str], most: int) -> str:
    return " ".join(names[:most]) + (" ..." if len(names) > most else "")


def _edge(graph: PoseGraph, edge: int) -> dict[str, int]:
    i, j = graph.ids[graph.edges[edge]].tolist()
    return {"from": i, "to": j}


def _folder(options: Namespace) -> Path:
    """Where the picture goes; made where it is named and not there."""
    if not options.output:
        return Path(options.graph) if Path(options.graph).is_dir() else Path()
    folder = Path(options.output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: can't be made ({error.strerror}); choose a place that can") from None
    return folder


def _picture(graph: PoseGraph, result: CheckResult, name: str) -> bytes:
    from mapmend.view.check_picture import check_png

    verdict = "consistent" if result.consistent else "inconsistent"
    failed = int(np.count_nonzero(result.scans.failed))
    return check_png(graph, result, f"{Path(name).name}: {verdict}, p = {result.p_value:.2g}, {failed} failed scans")
