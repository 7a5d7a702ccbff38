"""A log from a file or ROS bag; for other content, the error says what the file holds."""

from __future__ import annotations

from pathlib import Path

from mapmend.errors import InputError
from mapmend.io.bags.options import BagOptions
from mapmend.io.info import describe_content
from mapmend.io.reader import read
from mapmend.parallel import Progress, no_progress
from mapmend.scan import ScanLog


def read_log(
    path: str | Path, lenient: bool = False, bag: BagOptions | None = None, progress: Progress = no_progress
) -> ScanLog:
    """The log in a file or ROS bag; raises InputError that says what the file holds if it is no log."""
    content = read(path, lenient, bag, progress)
    if not isinstance(content, ScanLog):
        raise InputError(path, f"holds a {describe_content(content).kind}, not a log", "name a CARMEN log or a ROS bag")
    return content
