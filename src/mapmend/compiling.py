"""Reports when Numba compiles: only in the first run, when the kernels are not in its cache yet."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class CompileWatch:
    """``seconds`` spent compiling so far; ``tell`` is called once, before the first kernel is compiled."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self.seconds = 0.0
        self._tell = tell
        self._told = False
        self._depth = 0  # a kernel that calls another compiles it within its own compilation
        self._began = 0.0

    def start(self) -> None:
        """Numba begins to compile a kernel."""
        if not self._told:
            self._told = True
            self._tell()
        if self._depth == 0:
            self._began = time.perf_counter()
        self._depth += 1

    def end(self) -> None:
        """Numba has compiled a kernel."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began


@contextmanager
def watch_compiling(tell: Callable[[], None]) -> Iterator[CompileWatch]:
    """Watches Numba's own compile events within the block; a kernel from the cache causes none."""
    from numba.core import event

    watch = CompileWatch(tell)

    class Listener(event.Listener):
        def on_start(self, event: object) -> None:
            watch.start()

        def on_end(self, event: object) -> None:
            watch.end()

    with event.install_listener("numba:compile", Listener()):
        yield watch
