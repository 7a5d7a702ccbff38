"""``mapmend datasets``: public logs by name."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Any

from mapmend.commands.common.console import ProgressBar, print_json, say
from mapmend.datasets.cache import cache_folder, is_fetched
from mapmend.datasets.fetch import fetch
from mapmend.datasets.registry import DATASETS, Dataset, find
from mapmend.errors import MapmendError


def add_arguments(parser: ArgumentParser) -> None:
    parser.epilog = "A log that was fetched is read by its name: mapmend map intel -o RUN."
    parser.add_argument("action", choices=("list", "fetch"), nargs="?", default="list", help="default: list")
    parser.add_argument("names", metavar="NAME", nargs="*", help="the logs to fetch")
    parser.add_argument("--mirror", metavar="URL", help="fetch the files from this address instead, by their names")


def run(args: Namespace) -> int:
    """Lists the datasets, or fetches those that are named."""
    return _list(args) if args.action == "list" else _fetch(args)


def _list(args: Namespace) -> int:
    if args.names:
        raise MapmendError("mapmend datasets list takes no names; to fetch them: mapmend datasets fetch NAME")
    rows = [_row(dataset) for dataset in DATASETS]
    if args.json:
        print_json({"cache": str(cache_folder()), "datasets": rows})
        return 0
    width = max(len(row["name"]) for row in rows)
    for row in rows:
        print(f"{row['name'].ljust(width)}  {row['what']}; {'fetched' if row['fetched'] else 'not fetched'}")
    print(f"fetch one: mapmend datasets fetch NAME; then: mapmend map NAME -o RUN; they lie in {cache_folder()}")
    return 0


def _fetch(args: Namespace) -> int:
    if not args.names:
        raise MapmendError(f"name what to fetch: {', '.join(dataset.name for dataset in DATASETS)}")
    chosen = [_find(name) for name in args.names]
    rows = []
    for dataset in chosen:
        try:
            with ProgressBar() as progress:
                paths = fetch(dataset, mirror=args.mirror, progress=progress)
        except KeyboardInterrupt:
            say("what has come is kept; fetch again to go on from there")
            raise
        rows.append({**_row(dataset), "files": [str(path) for path in paths]})
        if not args.json:
            print("\n".join(_lines(rows[-1])))
    if args.json:
        print_json({"cache": str(cache_folder()), "datasets": rows})
    return 0


def _find(name: str) -> Dataset:
    dataset = find(name)
    if dataset is None:
        raise MapmendError(f"there is no dataset {name!a}; there are {', '.join(known.name for known in DATASETS)}")
    return dataset


def _row(dataset: Dataset) -> dict[str, Any]:
    return {
        "name": dataset.name,
        "what": dataset.what,
        "licence": dataset.licence,
        "citation": dataset.citation,
        "urls": [file.url for file in dataset.files],
        "fetched": all(is_fetched(file) for file in dataset.files),
    }


def _lines(row: dict[str, Any]) -> list[str]:
    lines = [f"{row['name']}: {row['what']}"]
    lines += [f"  file: {path}" for path in row["files"]]
    return [*lines, f"  licence: {row['licence']}", f"  cite: {row['citation']}"]
