"""The output of commands: progress, notes, tables, JSON."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING, Any

from mapmend.io.own_files import RUN_FILE

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

    from mapmend.compiling import CompileWatch
    from mapmend.scan import Note

QUIET_S = 1.0
MOST_NOTES = 8
COMPILING = "compiling kernels (first run only) ..."
COMPILING_AGAIN = "compiling kernels (at every run: no folder to keep them in; let NUMBA_CACHE_DIR name one) ..."


class ProgressBar:
    """A bar on standard error, if that is a terminal, for work of more than a second. Used as a context."""

    def __init__(self) -> None:
        self._began = time.monotonic()
        self._is_terminal = sys.stderr.isatty()
        self._bar: RichProgress | None = None
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Called by the library after each piece of work."""
        if not self._is_terminal or time.monotonic() - self._began < QUIET_S:
            return
        if self._bar is None:
            self._bar = _new_bar()
            self._bar.start()
        if stage not in self._tasks:
            self._tasks[stage] = self._bar.add_task(stage, total=total)
        self._bar.update(self._tasks[stage], completed=done, total=total)

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def _new_bar() -> RichProgress:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True)


@contextmanager
def told_compiling() -> Iterator[CompileWatch]:
    """Reports once on standard error if kernels are compiled within the block; the watch measures for how long."""
    from mapmend.compiling import watch_compiling

    with watch_compiling(_say_compiling) as watch:
        yield watch


def _say_compiling() -> None:
    from mapmend.kernel_cache import cache_folder

    say(COMPILING if cache_folder() else COMPILING_AGAIN)


def say(text: str) -> None:
    """One line for the user, on standard error."""
    print(f"mapmend: {text}", file=sys.stderr, flush=True)


def say_notes(notes: Sequence[Note]) -> None:
    """The first few notes on what is odd about a log, one on each line."""
    for note in notes[:MOST_NOTES]:
        say(f"note: {note}")
    if len(notes) > MOST_NOTES:
        say(f"note: {len(notes) - MOST_NOTES} more; see mapmend info")


def say_older(run_json: dict[str, Any]) -> None:
    """Which files in an output folder fit what was there before; ``run_json`` is the folder's."""
    older = run_json.get("older_files", {})
    folders = {name.removesuffix(f"/{RUN_FILE}") for name in older if name.endswith(f"/{RUN_FILE}")}
    names = sorted(folders | {name for name in older if not any(name.startswith(f"{f}/") for f in folders)})
    if names:
        more = f" and {len(names) - MOST_NOTES} more" if len(names) > MOST_NOTES else ""
        listed = ", ".join(names[:MOST_NOTES]) + more
        say(f"note: kept, but made from the output that was replaced: {listed}; make them again or remove them")


def print_json(values: dict[str, Any]) -> None:
    """The one object of ``--json``."""
    print(json.dumps(values, allow_nan=False))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Aligned columns: the first to the left, the others to the right."""
    lines = [tuple(head), *map(tuple, rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    lines.insert(1, tuple("-" * width for width in widths))
    return "\n".join(
        "  ".join(
            text.ljust(w) if k == 0 else text.rjust(w) for k, (text, w) in enumerate(zip(line, widths, strict=True))
        )
        for line in lines
    )
