"""``mapmend datasets``: public logs by name."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

from mapmend.commands.console import ProgressBar, print_json, say
from mapmend.datasets.cache import cache_folder, is_fetched
from mapmend.datasets.fetch import fetch
from mapmend.datasets.registry import DATASETS, Dataset, find
from mapmend.errors import MapmendError


def run(options: Namespace) -> int:
    """Lists what there is, or fetches what is named."""
    return _list(options) if options.action == "list" else _fetch(options)


def _list(options: Namespace) -> int:
    if options.names:
        raise MapmendError("mapmend datasets list takes no names; to fetch them: mapmend datasets fetch NAME")
    rows = [_row(dataset) for dataset in DATASETS]
    if options.json:
        print_json({"cache": str(cache_folder()), "datasets": rows})
        return 0
    width = max(len(row["name"]) for row in rows)
    for row in rows:
        print(f"{row['name'].ljust(width)}  {row['what']}; {'fetched' if row['fetched'] else 'not fetched'}")
    print(f"fetch one: mapmend datasets fetch NAME; then: mapmend map NAME -o RUN; they lie in {cache_folder()}")
    return 0


def _fetch(options: Namespace) -> int:
    if not options.names:
        raise MapmendError(f"name what to fetch: {', '.join(dataset.name for dataset in DATASETS)}")
    chosen = [_find(name) for name in options.names]
    rows = []
    for dataset in chosen:
        try:
            with ProgressBar() as progress:
                paths = fetch(dataset, mirror=options.mirror, progress=progress)
        except KeyboardInterrupt:
            say("what has come is kept; fetch again to go on from there")
            raise
        rows.append({**_row(dataset), "files": [str(path) for path in paths]})
        if not options.json:
            print("\n".join(_lines(rows[-1])))
    if options.json:
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
