"""Errors in a user's input, each with a one-line message."""

from __future__ import annotations

from pathlib import Path


class MapmendError(Exception):
    """An error that the user can correct; the command line prints it as one line and exits with 2."""


class InputError(MapmendError):
    """A file that cannot be used: which file, which line, what is wrong, and what to do about it."""

    def __init__(self, path: str | Path | None, what: str, mend: str = "", line: int | None = None) -> None:
        self.path = None if path is None else str(path)
        self.line = line
        self.what = what
        self.mend = mend
        super().__init__(self._text())

    def _text(self) -> str:
        place = "" if self.path is None else self.path
        if place and self.line is not None:
            place += f":{self.line}"
        text = f"{place}: {self.what}" if place else self.what
        return f"{text}; {self.mend}" if self.mend else text


class OutputError(MapmendError):
    """A result that cannot be written; no part of it remains."""
