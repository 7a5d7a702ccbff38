"""Do two commits give the same bytes? RUN folders and the outputs of check, tune and optimize, file by file.

    python benchmarks/same_bytes.py OLD NEW [--store DIR]

Each commit is checked out into a folder of its own and run with this Python. These outputs are compared: igo, go and
scanmatch on intel, fr079 and a simulated corridor; `check` and `tune` of the scan graphs in the data folder; `optimize`
of its pose graphs. JSON is compared without version, seconds and settings. The exit code is 1 if an output differs.
`--store` keeps the checksums of a commit, so that no commit is run twice.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import _measure

METHODS = ("igo", "go", "scanmatch")
SCAN_GRAPHS = ("fr079.toro.gz", "intel.toro.gz", "killian.g2o.gz")
POSE_GRAPHS = ("M3500.g2o.gz", "M3500a.g2o.gz", "intel.g2o.gz", "ringCity.g2o.gz", "bicocca25b_0.500.g2o.gz")
STARTS_AND_KERNELS = (("given", "none"), ("chordal", "none"), ("odometry", "dcs"), ("odometry", "gnc"))
KINDS = ("map", "check", "tune", "optimize")
# Parts of a JSON output that say when, where and by what it was made, and not what came of it.
NOT_RESULTS = {
    "seconds",
    "version",
    "configuration",
    "settings",
    "source",
    "log",
    "files",
    "output",
    "picture",
    "run",
    "graph",
}

Sums = dict[str, str]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", help="a commit")
    parser.add_argument("new", help="another commit")
    parser.add_argument("--data", default=os.environ.get("MAPMEND_DATA"), help="default: what MAPMEND_DATA names")
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS), help="some of the outputs")
    parser.add_argument("--store", type=Path, help="a folder that keeps the sums of each commit")
    arguments = parser.parse_args()
    if not arguments.data:
        _measure.stop("name the folder with the recordings by --data, or set MAPMEND_DATA")
    old, new = (sums_of(commit, arguments) for commit in (arguments.old, arguments.new))
    both = sorted(old.keys() & new.keys())
    differing = [name for name in both if old[name] != new[name]]
    lost, added = old.keys() - new.keys(), new.keys() - old.keys()
    for what, names in (("differs", differing), ("lost", lost), ("new", added)):
        for name in sorted(names):
            print(f"{what}: {name}")
    print(f"{len(both) - len(differing)} outputs are the same, {len(differing)} differ")
    return 1 if differing or lost else 0


def sums_of(commit: str, arguments: argparse.Namespace) -> Sums:
    """The sums of all outputs of a commit, by their names; from the store where they are known."""
    named = subprocess.run(["git", "rev-parse", f"{commit}^{{commit}}"], check=True, capture_output=True, text=True)
    full = named.stdout.strip()
    kept = arguments.store / f"{full}.json" if arguments.store else None
    known: dict[str, Sums] = json.loads(kept.read_text()) if kept and kept.is_file() else {}
    missing = [kind for kind in arguments.only if kind not in known]
    if missing:
        with tempfile.TemporaryDirectory() as folder:
            checkout = Path(folder) / "checkout"
            checkout.mkdir()
            archive = subprocess.run(["git", "archive", full], check=True, capture_output=True).stdout
            subprocess.run(["tar", "-x", "-C", str(checkout)], input=archive, check=True)
            for kind in missing:
                known[kind] = dict(KIND_OUTPUTS[kind](Command(checkout), Path(arguments.data).resolve(), Path(folder)))
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps(known, indent=1))
    return {f"{kind} {name}": one for kind in arguments.only for name, one in known[kind].items()}


class Command:
    """The mapmend of a checkout."""

    def __init__(self, checkout: Path) -> None:
        self._environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
        self._folder = checkout.parent

    def __call__(self, *arguments: object) -> str:
        """Runs it and gives what it prints; the answer "no" (exit code 1) is an answer."""
        words = [sys.executable, "-m", "mapmend", *map(str, arguments)]
        print(" ".join(words[2:]), file=sys.stderr, flush=True)
        done = subprocess.run(
            words, check=False, capture_output=True, text=True, env=self._environment, cwd=self._folder
        )
        if done.returncode not in {0, 1}:
            _measure.stop(f"{' '.join(words)} failed: {done.stderr.strip()}")
        return done.stdout


def map_outputs(mapmend: Command, data: Path, folder: Path) -> Iterator[tuple[str, str]]:
    mapmend("simulate", "-o", folder / "demo", "--world", "corridor", "--seed", 0)
    logs = {name: data / "logs" / f"{name}.clf.bz2" for name in ("intel", "fr079")} | {"demo": folder / "demo/log.clf"}
    for name, log in logs.items():
        for method in METHODS:
            run = folder / f"{name}-{method}"
            mapmend("map", log, "-o", run, "--method", method)
            for path in sorted(run.iterdir()):
                if path.suffix == ".json":
                    yield from sums_of_json(f"{name} {method} {path.name}", path.read_text())
                else:
                    yield f"{name} {method} {path.name}", sum_of(path)


def check_outputs(mapmend: Command, data: Path, folder: Path) -> Iterator[tuple[str, str]]:
    for name in SCAN_GRAPHS:
        yield from sums_of_json(name, mapmend("check", data / "scangraphs" / name, "--json"))


def tune_outputs(mapmend: Command, data: Path, folder: Path) -> Iterator[tuple[str, str]]:
    for name in SCAN_GRAPHS:
        tuned = folder / f"tuned-{name}"
        yield from sums_of_json(name, mapmend("tune", data / "scangraphs" / name, "-o", tuned, "--json"))
        yield f"{name} graph", sum_of(tuned / "graph.g2o")


def optimize_outputs(mapmend: Command, data: Path, folder: Path) -> Iterator[tuple[str, str]]:
    for name in POSE_GRAPHS:
        for start, kernel in STARTS_AND_KERNELS:
            best = folder / "best.g2o"
            said = mapmend(
                *("optimize", data / "posegraphs" / name, "-o", best, "--init", start, "--kernel", kernel, "--json")
            )
            yield from sums_of_json(f"{name} {start} {kernel}", said)
            yield f"{name} {start} {kernel} graph", sum_of(best)


KIND_OUTPUTS = {"map": map_outputs, "check": check_outputs, "tune": tune_outputs, "optimize": optimize_outputs}


def sum_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def sums_of_json(name: str, text: str) -> Iterator[tuple[str, str]]:
    """A sum for each part of a JSON object that is a result."""
    for key, part in without_circumstances(json.loads(text)).items():
        yield f"{name} {key}", hashlib.sha256(json.dumps(part, sort_keys=True).encode()).hexdigest()


def without_circumstances(value: Any) -> Any:
    """The same value without those of its parts that are no results."""
    if isinstance(value, dict):
        return {key: without_circumstances(part) for key, part in value.items() if key not in NOT_RESULTS}
    if isinstance(value, list):
        return [without_circumstances(part) for part in value]
    return value


if __name__ == "__main__":
    raise SystemExit(main())
