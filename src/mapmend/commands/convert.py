"""``mapmend convert``: a file to another format."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from mapmend.commands.common.console import print_json, say_notes
from mapmend.commands.common.options import add_bag, add_lenient, bag_options
from mapmend.io.formats import BY_SUFFIX, FORMATS


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = (
        "CARMEN files and ROS 2 bags hold logs, g2o and TORO files graphs, TUM and KITTI files trajectories. "
        "Lists what the new format cannot hold; refuses conversions that make no sense, and says why."
    )
    parser.add_argument("source", metavar="IN", help="a log, ROS bag, graph or trajectory, or a RUN folder")
    parser.add_argument("target", metavar="OUT", help=f"the file to write: {' '.join(filter(None, BY_SUFFIX))}")
    parser.add_argument(
        "--to", choices=FORMATS, help="the format, if the name of OUT does not say it (a name without suffix: a bag)"
    )
    parser.add_argument("--stamps", metavar="FILE", help="stamps for poses that have none: seconds, one a line")
    add_bag(parser)
    add_lenient(parser)


def run(args: Namespace) -> int:
    """Converts, and says what the new file cannot hold."""
    from mapmend.datasets.cache import named_file
    from mapmend.io.convert import convert

    done = convert(
        named_file(args.source),
        args.target,
        args.to,
        bag=bag_options(args),
        stamps=named_file(args.stamps) if args.stamps else None,
        lenient=args.lenient,
    )
    say_notes(done.notes)
    if args.json:
        values = {"from": args.source, "to": args.target, "kind": done.kind, "format": done.format}
        print_json({**values, "count": done.count, "lost": list(done.lost)})
        return 0
    what = {"log": "scans", "graph": "nodes"}.get(done.kind, "poses")
    print(f"{args.target}: {done.format}, {done.count} of the {done.kind}'s {what}")
    for loss in done.lost:
        print(f"  lost: {loss}")
    return 0
