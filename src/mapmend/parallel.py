"""The one place where work is spread over threads, progress is reported and Ctrl-C is handled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


class Progress(Protocol):
    """Called after each piece of work: with the stage, how much is done, and of how much."""

    def __call__(self, stage: str, done: int, total: int) -> None: ...


def no_progress(stage: str, done: int, total: int) -> None:
    """Reports nothing."""


def map_in_order(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    threads: int = 1,
    stage: str = "",
    progress: Progress = no_progress,
) -> list[Result]:
    """``[function(x) for x in items]`` over threads: the same results in the same order for any number of them.

    ``function`` should spend its time in kernels that release the GIL. Ctrl-C cancels what has not begun.
    """
    total = len(items)
    results: list[Result] = []
    if threads <= 1 or total <= 1:
        for k, item in enumerate(items):
            results.append(function(item))
            progress(stage, k + 1, total)
        return results
    pool = ThreadPoolExecutor(max_workers=threads)
    try:
        for k, result in enumerate(pool.map(function, items)):
            results.append(result)
            progress(stage, k + 1, total)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return results
