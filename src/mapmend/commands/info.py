"""``mapmend info``: what a file holds, and what is odd about it."""

from __future__ import annotations

from argparse import Namespace

from mapmend.commands.console import bag_options, print_json
from mapmend.datasets.cache import named_file
from mapmend.io.info import describe


def run(options: Namespace) -> int:
    """Describes ``options.file``."""
    info = describe(named_file(options.file), options.lenient, bag_options(options))
    if options.json:
        print_json(info.to_dict())
    else:
        print("\n".join(info.lines()))
    return 0
