"""The command line: finds the command and its parser, runs it, and reports an error in one line.

Only argparse is imported until a command runs: ``mapmend --help`` and ``mapmend COMMAND --help`` answer before NumPy
would be loaded. Exit codes: 0 for yes, 1 for no, 2 for could not (one line on standard error), 130 after Ctrl-C, 143
after SIGTERM.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import NoReturn

from mapmend.commands import SUMMARIES
from mapmend.errors import MapmendError
from mapmend.interrupts import PLACED, Terminated, terminable, what_was_written
from mapmend.version import VERSION

COULD_NOT, INTERRUPTED, TERMINATED = 2, 130, 143
TRACEBACK_VARIABLE = "MAPMEND_TRACEBACK"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one command, ``sys.argv`` by default, and returns its exit code. An error is reported in one line."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    words = sys.argv[1:] if arguments is None else list(arguments)
    PLACED.clear()
    try:
        with terminable():
            args = parser(_command_named(words)).parse_args(words)
            code: int = _module(args.command).run(args)
            sys.stdout.flush()
            return code
    except Terminated:
        return _fail(f"terminated; {what_was_written()}", TERMINATED)
    except KeyboardInterrupt:
        return _fail(f"interrupted; {what_was_written()}", INTERRUPTED)
    except MapmendError as error:
        return _fail(str(error), COULD_NOT)
    except MemoryError:
        return _fail("not enough memory; take larger cells (grid.cell_size_m) or a shorter log", COULD_NOT)
    except BrokenPipeError:
        # The reader of our output closed the pipe; the interpreter must not report this at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return COULD_NOT
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _fail(f"{place}{error.strerror or error}; check the path and the disk", COULD_NOT)
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        what = f"{type(error).__name__}: {error}"
        return _fail(f"internal error ({what}); set {TRACEBACK_VARIABLE}=1 and report what it shows", COULD_NOT)


def parser(command: str | None = None) -> argparse.ArgumentParser:
    """The parser of the command line: all commands by name, and the arguments of the one that is named."""
    top = _Parser(prog="mapmend", description="2D laser SLAM that mends its own graph.", allow_abbrev=False)
    top.add_argument("--version", action="version", version=f"mapmend {VERSION}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    for name, summary in SUMMARIES.items():
        description = f"{summary[0].upper()}{summary[1:]}."
        own = commands.add_parser(name, help=summary, description=description, allow_abbrev=False)
        if name == command:
            own.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
            _module(name).add_arguments(own)
    return top


def _command_named(words: Sequence[str]) -> str | None:
    """The command that the words name, if any: no option before it takes a value."""
    return next((word for word in words if not word.startswith("-") and word in SUMMARIES), None)


def _module(command: str) -> ModuleType:
    return import_module(f"mapmend.commands.{command}")


def _fail(what: str, code: int) -> int:
    """One line on standard error, even if the message has several."""
    line = " ".join(what.split())
    # On a terminal, the cursor may be in the middle of a progress bar's line.
    start = "\r" if sys.stderr.isatty() else ""
    print(f"{start}mapmend: {line}", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """Wrong arguments are also reported in one line, not with a page of usage."""

    def error(self, message: str) -> NoReturn:
        raise MapmendError(f"{message}; see {self.prog} --help")
