"""``mapmend info``: what a file holds, and what is odd about it."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from mapmend.commands.common.console import print_json
from mapmend.commands.common.options import add_bag, add_lenient, bag_options


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="the file (.gz and .bz2 too), a ROS bag, or a RUN folder")
    add_bag(parser)
    add_lenient(parser)


def run(args: Namespace) -> int:
    """Describes ``args.file``."""
    from mapmend.datasets.cache import named_file
    from mapmend.io.info import describe

    info = describe(named_file(args.file), args.lenient, bag_options(args))
    if args.json:
        print_json(info.to_dict())
    else:
        print("\n".join(info.lines()))
    return 0
