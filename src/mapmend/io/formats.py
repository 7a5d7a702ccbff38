"""The formats that can be written, what each holds, and which file names mean which format."""

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
"""The format of each suffix; a name without one is that of a bag's folder."""

BAG_FILE, BAG_DATABASE = ".mcap", ".db3"  # the storage of a ROS 2 bag
PACKED = (".gz", ".bz2")  # compressed files are read too, but never written


def format_of(path: str | Path) -> str:
    """The format by a file's name; raises MapmendError if the name has none."""
    suffix = Path(path).suffix.lower()
    if suffix == ".bag":
        raise MapmendError(f"{path}: ROS 1 bags are read, not written; name a folder or a .mcap file for a ROS 2 bag")
    if suffix not in BY_SUFFIX:
        raise MapmendError(f"{path}: the name has no known suffix; choose a format with --to: {', '.join(FORMATS)}")
    return BY_SUFFIX[suffix]


def graph_format_of(path: str | Path) -> str | None:
    """The format of a graph by a file's name, None if the name has another format or none."""
    named = BY_SUFFIX.get(Path(path).suffix.lower())
    return named if named in GRAPH_FORMATS else None
