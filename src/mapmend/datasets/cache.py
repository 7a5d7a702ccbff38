"""The user's cache of fetched files, and how a name is resolved to one of them. It needs only Python."""

from __future__ import annotations

import hashlib
import os
import sys
from pathlib import Path

from mapmend.datasets import registry
from mapmend.datasets.registry import RemoteFile, find_file
from mapmend.errors import InputError

CACHE_VARIABLE = "MAPMEND_CACHE"


def cache_folder() -> Path:
    """The folder of fetched files: the one that MAPMEND_CACHE names, otherwise a folder in the user's cache of the
    system."""
    named = os.environ.get(CACHE_VARIABLE)
    return Path(named) if named else user_folder()


def user_folder() -> Path:
    """mapmend's folder in the user's cache of the system. Raises RuntimeError if the user has no home folder."""
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "mapmend"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "mapmend" / "Cache"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "mapmend"


def is_fetched(file: RemoteFile) -> bool:
    """Whether the file is in the cache, complete and with the right content."""
    path = cache_folder() / file.name
    try:
        return path.is_file() and sha256_of(path) == file.sha256
    except OSError:
        return False


def sha256_of(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def named_file(name: str | Path) -> Path:
    """The file or folder of this name; if there is none, the fetched file of the public log with this name.

    Commands call this for each input that a user names; ``mapmend.read`` and all of ``io`` take only paths. A name that
    is neither is returned as a path, which its reader then refuses. Raises InputError for a public log that has not
    been fetched, or that is damaged.
    """
    if os.path.exists(name):
        return Path(name)
    return fetched_path(name) or Path(name)


def fetched_path(name: str | Path) -> Path | None:
    """The fetched file that a name stands for; None for a name that is not a public log's.

    Raises InputError for one that has not been fetched, or that is damaged.
    """
    file = find_file(str(name))
    if file is None:
        return None
    dataset = next(dataset.name for dataset in registry.DATASETS if file in dataset.files)
    mend = f"fetch it with: mapmend datasets fetch {dataset}"
    if not (cache_folder() / file.name).is_file():
        raise InputError(name, "no such file; of the public logs, it is one that has not been fetched", mend)
    if not is_fetched(file):
        raise InputError(cache_folder() / file.name, "does not have the expected content", mend)
    return cache_folder() / file.name
