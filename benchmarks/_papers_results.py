"""The results of a run of papers.py: lines of JSON, tables, and the answers of `mapmend`."""

from __future__ import annotations

import json
import statistics
from pathlib import Path
from typing import Any


class Results:
    """Reads the folder of a run; missing results are returned empty."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def printed(self, step: str) -> str:
        """What a step that is done printed."""
        path = self._folder / f"{step}.out"
        return path.read_text().strip() if path.is_file() else ""

    def answer(self, step: str) -> dict[str, Any]:
        """The JSON object that a step printed."""
        text = self.printed(step)
        found: dict[str, Any] = json.loads(text) if text else {}
        return found

    def lines(self, name: str) -> list[dict[str, Any]]:
        path = self._folder / f"{name}.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []

    def compared(self, log: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.answer(f"compare-{log}").get("methods", [])
        return found

    def errors(self, name: str, method: str, value: str = "error_m", **wanted: Any) -> dict[int, float]:
        """By seed, of the lines of ``name`` with these values."""
        rows = [row for row in self.lines(name) if row["method"] == method]
        return {row["seed"]: row[value] for row in rows if all(row[key] == value_ for key, value_ in wanted.items())}

    def table(self, step: str) -> list[dict[str, str]]:
        """The first Markdown table that a step printed, a dictionary a row."""
        lines = [line.strip("| ").split(" | ") for line in self.printed(step).splitlines() if line.startswith("|")]
        lines = [[cell.strip() for cell in line] for line in lines]
        return [dict(zip(lines[0], line, strict=False)) for line in lines[2:]] if lines else []

    def commands(self) -> list[tuple[str, list[str], float]]:
        """Steps that are done: name, arguments, seconds."""
        found = []
        for path in sorted(self._folder.glob("*.json")):
            page = json.loads(path.read_text())
            if "arguments" in page:
                found.append((path.stem, page["arguments"], page["seconds"]))
        return found


def median(errors: dict[int, float]) -> float:
    return statistics.median(errors.values())


def in_order(worse: dict[int, float], better: dict[int, float]) -> tuple[int, int]:
    """In how many of the common seeds the first is above the second."""
    common = worse.keys() & better.keys()
    return sum(worse[seed] > better[seed] for seed in common), len(common)
