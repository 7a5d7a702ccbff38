"""Ctrl-C and SIGTERM: both end a command in order, and neither while an output is being put in its place."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

PLACED: list[str] = []
"""The outputs that this command has put in place so far: after that, it must not say that nothing was written."""


def what_was_written() -> str:
    """For the line that says that a command was interrupted."""
    return f"{', '.join(PLACED)} was written before" if PLACED else "nothing was written"


class Terminated(KeyboardInterrupt):
    """SIGTERM has come; whatever cleans up after Ctrl-C cleans up after this."""


@contextmanager
def terminable() -> Iterator[None]:
    """Raise Terminated where SIGTERM comes within the block; what is ignored, as under nohup, stays ignored."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(_number: int, _frame: FrameType | None) -> None:
    raise Terminated


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C and SIGTERM wait until the end of the block: it takes milliseconds, and must not be left half done."""
    if threading.current_thread() is not threading.main_thread():
        yield  # Python handles signals in the main thread alone
        return
    came: list[int] = []
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        handler = signal.getsignal(number)
        if handler not in (None, signal.SIG_IGN):
            before[number] = handler
            signal.signal(number, lambda n, _frame: came.append(n))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
