"""The command line as a process of its own that is interrupted in the middle of its work."""

import os
import signal
import subprocess
import sys
from pathlib import Path

from mapmend import cli

INTERRUPT = """
import os, signal, sys
from mapmend import cli
from mapmend.commands.common import console

def interrupt(self, stage, done, total):
    if stage == sys.argv[1]:
        os.kill(os.getpid(), int(sys.argv[2]))

console.ProgressBar.__call__ = interrupt
sys.exit(cli.main(sys.argv[3:]))
"""


def interrupted(stage, *arguments, number=signal.SIGINT):
    """Runs ``mapmend`` and sends it Ctrl-C, or another signal, when it first tells progress of ``stage``."""
    return subprocess.run(
        [sys.executable, "-c", INTERRUPT, stage, str(int(number)), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        # A test run in the background of a shell has SIGINT ignored, and hands that on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        env={**os.environ, "PYTHONPATH": str(Path(cli.__file__).parents[1])},
    )
