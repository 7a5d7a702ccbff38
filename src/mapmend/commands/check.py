"""``mapmend check``: whether a map is consistent, and where not."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapmend.commands.common.console import ProgressBar, print_json, say, say_notes, table, told_compiling
from mapmend.commands.common.inputs import load_graph
from mapmend.commands.common.options import add_config, add_threads, read_config, thread_count
from mapmend.errors import InputError, MapmendError

if TYPE_CHECKING:
    from mapmend.consistency.check import CheckResult
    from mapmend.graph.pose_graph import PoseGraph

INCONSISTENT = 1
PICTURE = "check.png"
MOST_REGIONS, MOST_SUSPECTS, MOST_SCANS = 5, 3, 4
"""At most this many of each are listed as text; JSON has all of them."""


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "Needs a pose graph whose nodes carry scans, and no ground truth. Writes check.png."
    parser.add_argument("graph", metavar="RUN|GRAPH", help="a RUN folder, or a g2o or TORO graph (.gz and .bz2 too)")
    parser.add_argument(
        "-o", "--output", metavar="DIR", help="folder for check.png (default: the RUN, or the current folder)"
    )
    add_config(parser)
    add_threads(parser)


def run(args: Namespace) -> int:
    """Checks ``args.graph``; returns 0 if it is consistent, 1 if not."""
    from mapmend.consistency.check import check
    from mapmend.io.output import check_own_writable, write_own

    config = read_config(args)
    graph = load_graph(args.graph)
    picture = _folder(args) / PICTURE
    check_own_writable(picture)
    try:
        with ProgressBar() as progress, told_compiling():
            result = check(graph, config, threads=thread_count(args.threads), progress=progress)
    except MapmendError as error:
        raise InputError(args.graph, str(error)) from error
    say_notes(graph.notes)
    for note in result.notes:
        say(f"note: {note}")
    write_own(picture, _picture(graph, result, args.graph))
    values = report(graph, result)
    if args.json:
        print_json({**values, "picture": str(picture)})
    else:
        print("\n".join(lines(values, picture)))
    return 0 if result.consistent else INCONSISTENT


def report(graph: PoseGraph, result: CheckResult) -> dict[str, Any]:
    """The output of ``--json``; nodes by their ids."""
    corners = result.views.scans.polygons.offsets
    return {
        "consistent": result.consistent,
        "p_value": result.p_value,
        "scans": int((corners[1:] > corners[:-1]).sum()),
        "scans_tested": result.scans.count,
        "scans_inconsistent": int(result.scans.failed.sum()),
        "pairs": len(result.pairs.pairs),
        "pairs_overlapping": result.overlapping,
        "pairs_failed": int(result.pairs.failed.sum()),
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


def lines(values: dict[str, Any], picture: Path) -> list[str]:
    """The report as text."""
    verdict = "consistent" if values["consistent"] else "INCONSISTENT"
    text = [
        f"the map is {verdict}: p = {values['p_value']:.3g}",
        f"  scans: {values['scans_inconsistent']} of {values['scans_tested']} contradict the others",
        f"  pairs: {values['pairs_failed']} of {values['pairs']} failed ({values['pairs_overlapping']} overlap)",
    ]
    regions = values["regions"][:MOST_REGIONS]
    if regions:
        rows = [_region_row(number, region) for number, region in enumerate(regions, start=1)]
        text += ["", table(("region", "x [m]", "y [m]", "size [m]", "pairs", "scans", "which", "loop edges"), rows)]
        rest = len(values["regions"]) - len(regions)
        text += [f"and {rest} smaller one{'s' * (rest != 1)}"] if rest else []
    if values["suspect_edges"] and not values["consistent"]:
        suspects = [f"{edge['from']} -> {edge['to']}" for edge in values["suspect_edges"][:MOST_SUSPECTS]]
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


def _folder(args: Namespace) -> Path:
    """Where the picture goes: the folder that is named, the RUN, or the working directory."""
    if args.output:
        return Path(args.output)
    return Path(args.graph) if Path(args.graph).is_dir() else Path()


def _picture(graph: PoseGraph, result: CheckResult, name: str) -> bytes:
    from mapmend.view.check_picture import check_png

    verdict = "consistent" if result.consistent else "inconsistent"
    failed = int(result.scans.failed.sum())
    return check_png(graph, result, f"{Path(name).name}: {verdict}, p = {result.p_value:.2g}, {failed} failed scans")
