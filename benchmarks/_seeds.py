"""Shared code of benchmarks over many seeds: results as lines of JSON, from which a later run continues, and
spreads."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from _measure import markdown

Row = TypeVar("Row")


@dataclass(frozen=True)
class Spread:
    """The quartiles of errors over seeds, the worst of them, and the seed that it belongs to."""

    seeds: int
    lower: float
    median: float
    upper: float
    worst: float
    worst_seed: int

    @staticmethod
    def of(errors: dict[int, float]) -> Spread:
        """Of the errors by seed, one at least."""
        seeds, values = list(errors), np.array(list(errors.values()))
        lower, median, upper = np.quantile(values, (0.25, 0.5, 0.75)).tolist()
        worst = int(np.argmax(values))
        return Spread(len(seeds), lower, median, upper, float(values[worst]), seeds[worst])

    def cells(self, digits: int) -> tuple[str, ...]:
        """Seeds, median, quartiles, worst and its seed, as a table shows them."""
        quartiles = f"{self.lower:.{digits}f} to {self.upper:.{digits}f}"
        return str(self.seeds), f"{self.median:.{digits}f}", quartiles, f"{self.worst:.{digits}f}", str(self.worst_seed)


MOST_NAMED = 3
HEAD = ("seeds", "median", "quartiles", "worst", "its seed")


class Results(Generic[Row]):
    """Rows, of a frozen dataclass, in a file of JSON lines; those of one ``key`` are measured once."""

    def __init__(self, path: Path, row: type[Row], key: Callable[[Row], tuple[Any, ...]]) -> None:
        self._path = path
        self._key = key
        lines = path.read_text().splitlines() if path.is_file() else []
        self.rows: list[Row] = [row(**json.loads(line)) for line in lines]
        self._known = {key(one) for one in self.rows}

    def measure(self, keys: Iterable[tuple[Any, ...]], measured: Callable[..., Row]) -> None:
        """Measures what is missing, each by ``measured(*key)``, and stores it at once."""
        for key in keys:
            if key not in self._known:
                one = measured(*key)
                self.rows.append(one)
                self._known.add(key)
                with self._path.open("a") as stream:
                    stream.write(json.dumps(asdict(one)) + "\n")  # type: ignore[call-overload]


def paired(errors: dict[int, float], others: dict[int, float], margin: float = 0.0) -> str:
    """In how many of the common seeds the first is worse than the others by more than ``margin``, and if few, which."""
    both = sorted(errors.keys() & others.keys())
    worse = [seed for seed in both if errors[seed] > others[seed] + margin]
    return f"{len(worse)} of {len(both)}" + (f" ({', '.join(map(str, worse))})" if 0 < len(worse) <= MOST_NAMED else "")


def spread_table(first: Sequence[str], rows: Sequence[tuple[Sequence[str], dict[int, float]]], digits: int = 3) -> str:
    """A table: the ``first`` columns' heads, and of each row its cells and the errors by seed."""
    return markdown((*first, *HEAD), [(*cells, *Spread.of(errors).cells(digits)) for cells, errors in rows])
