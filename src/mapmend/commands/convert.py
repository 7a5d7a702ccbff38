"""``mapmend convert``: one file in, another kind of file out."""

from __future__ import annotations

from argparse import Namespace

from mapmend.commands.console import bag_options, print_json, say_notes
from mapmend.datasets.cache import named_file
from mapmend.io.convert import convert


def run(options: Namespace) -> int:
    """Converts, and says what the new file has no place for."""
    done = convert(
        named_file(options.source),
        options.target,
        options.to,
        bag=bag_options(options),
        stamps=named_file(options.stamps) if options.stamps else None,
        lenient=options.lenient,
    )
    say_notes(done.notes)
    if options.json:
        page = {"from": options.source, "to": options.target, "kind": done.kind, "format": done.format}
        print_json({**page, "count": done.count, "lost": list(done.lost)})
        return 0
    what = {"log": "scans", "graph": "nodes"}.get(done.kind, "poses")
    print(f"{options.target}: {done.format}, {done.count} of the {done.kind}'s {what}")
    for loss in done.lost:
        print(f"  lost: {loss}")
    return 0
