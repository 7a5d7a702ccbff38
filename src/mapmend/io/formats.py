"""The formats that files are written in, what each holds, and which names ask for which."""

from __future__ import annotations

from pathlib import Path

from mapmend.errors import MapmendError

LOG_FORMATS = ("carmen", "mcap", "sqlite3")
GRAPH_FORMATS = ("g2o", "toro")
TRAJECTORY_FORMATS = ("tum", "kitti")
FORMATS = (*LOG_FORMATS, *GRAPH_FORMATS, *TRAJECTORY_FORMATS)

BY_SUFFIX = {
    ".clf": "carmen", ".log": "carmen", ".carmen": "carmen", ".mcap": "mcap", "": "mcap", ".g2o": "g2o",
    ".toro": "toro", ".graph": "toro", ".tum": "tum", ".kitti": "kitti",
}  # fmt: skip
"""The format that a suffix asks for; a name without one is that of a bag's folder."""

BAG_FILE, BAG_DATABASE = ".mcap", ".db3"  # what a ROS 2 bag keeps its messages in
PACKED = (".gz", ".bz2")  # read as if they were not packed; never written


def format_of(path: str | Path) -> str:
    """The format that a file's name asks for; raises MapmendError where it asks for none."""
    suffix = Path(path).suffix.lower()
    if suffix == ".bag":
        raise MapmendError(f"{path}: ROS 1 bags are read, not written; name a folder or a .mcap file for a ROS 2 bag")
    if suffix not in BY_SUFFIX:
        raise MapmendError(f"{path}: the name tells no format; choose one with --to: {', '.join(FORMATS)}")
    return BY_SUFFIX[suffix]


def graph_format_of(path: str | Path) -> str | None:
    """The format of graphs that a file's name asks for, None where it asks for another or none."""
    named = BY_SUFFIX.get(Path(path).suffix.lower())
    return named if named in GRAPH_FORMATS else None
