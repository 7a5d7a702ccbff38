"""Hidden files and folders in which outputs are made, locked while the process that made them lives.

Their names are ``.NAME.mapmend-xxxxxxxx``. The system releases the locks of a killed process. So if another process
can lock such a file, its process is gone, and `mapmend.io.swap.sweep` removes it.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

HIDDEN = re.compile(r"\..{1,40}\.mapmend-[a-z0-9_]{8}", re.DOTALL)
_NAME_CHARACTERS = 40
_LOCK, _PLAN, _NEW = "lock", "plan.json", "new"
_TRIES = 100
_PIECE_BYTES = 1 << 22


class Staging:
    """A hidden, locked folder; the output is made in ``new``, a folder in it.

    The plan, when it is written, describes how ``new`` is put in place, so that the next command can finish it after a
    kill.
    """

    def __init__(self, parent: Path, name: str) -> None:
        for _ in range(_TRIES):
            self.path = Path(tempfile.mkdtemp(prefix=_prefix(name), dir=parent))
            try:
                descriptor = os.open(self.path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            except FileNotFoundError:
                continue  # a sweeping process removed it before it had its lock
            self._lock = descriptor
            if _is_locked_in_place(descriptor, self.path / _LOCK):
                break
            os.close(descriptor)
        else:
            raise BlockingIOError(errno.EAGAIN, "hidden folders vanish as soon as they are made", str(parent))
        self.new.mkdir()
        self.new.chmod(0o777 & ~umask())

    @property
    def new(self) -> Path:
        """The folder that takes the output."""
        return self.path / _NEW

    def release(self) -> None:
        """Release the lock; what is still in the folder may be swept from now on."""
        os.close(self._lock)


def write_plan(folder: Path, plan: dict[str, Any]) -> None:
    """Write the plan into a hidden folder, in one step and synced to the disk."""
    temporary = folder / f"{_PLAN}.part"
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
    try:
        write_all(descriptor, json.dumps(plan).encode())
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    os.rename(temporary, folder / _PLAN)
    sync_folder(folder)


def read_plan(folder: Path) -> dict[str, Any] | None:
    """The plan in a hidden folder; None if none was written yet. Raises ValueError if it is not a plan."""
    try:
        plan = json.loads((folder / _PLAN).read_bytes())
    except FileNotFoundError:
        return None
    if not isinstance(plan, dict):
        raise ValueError(f"{folder}: holds no plan of mapmend's")
    return plan


def new_of(folder: Path) -> Path:
    """The folder in a hidden folder that takes the output."""
    return folder / _NEW


def remove_emptied(folder: Path) -> None:
    """Remove a hidden folder whose ``new`` is gone; the lock last, so that no other process begins with it."""
    for name in (f"{_PLAN}.part", _PLAN, _LOCK):
        (folder / name).unlink(missing_ok=True)
    folder.rmdir()


def is_dead_file(path: Path) -> bool:
    """Whether the process that wrote a hidden file is gone."""
    descriptor = _locked_now(path)
    if descriptor is not None:
        os.close(descriptor)
    return descriptor is not None


@contextmanager
def dead_folder(folder: Path) -> Iterator[bool]:
    """Whether the process that made a hidden folder is gone; if so, the folder is locked within the block."""
    try:
        descriptor = _locked_now(folder / _LOCK)
    except FileNotFoundError:
        # Killed before it had a lock, or after all else was removed: then it is empty. Otherwise it is not ours.
        with suppress(OSError):
            folder.rmdir()
        yield False
        return
    try:
        yield descriptor is not None
    finally:
        if descriptor is not None:
            os.close(descriptor)


@contextmanager
def hidden_file(folder: Path, name: str) -> Iterator[tuple[int, Path]]:
    """A new hidden, locked file, open for writing: its descriptor and path. Gone at the end if nobody renamed it."""
    for _ in range(_TRIES):
        descriptor, text = tempfile.mkstemp(prefix=_prefix(name), dir=folder)
        path = Path(text)
        if _is_locked_in_place(descriptor, path):
            break
        os.close(descriptor)
    else:
        raise BlockingIOError(errno.EAGAIN, "hidden files vanish as soon as they are made", str(folder))
    try:
        yield descriptor, path
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


def write_all(descriptor: int, data: bytes | memoryview) -> None:
    """All bytes, in pieces, to a file, device or pipe."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest[:_PIECE_BYTES]) :]


def sync_folder(folder: Path) -> None:
    """Sync a folder's entries to the disk, if its file system can do this for folders."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Sync all files below a folder, and the folders, to the disk."""
    for place, _, names in os.walk(folder):
        for name in names:
            descriptor = os.open(Path(place) / name, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        sync_folder(Path(place))


def umask() -> int:
    """The user's mask, which temporary files ignore."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _prefix(name: str) -> str:
    return f".{name[:_NAME_CHARACTERS]}.mapmend-"


def _is_locked_in_place(descriptor: int, path: Path) -> bool:
    """Lock an open file for this process; False if a sweeping process removed it before the lock was held."""
    with suppress(OSError):  # a file system without locks: no process can lock it there, so none sweeps
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat(follow_symlinks=False))
    except FileNotFoundError:
        return False


def _locked_now(path: Path) -> int | None:
    """A descriptor that holds the lock of a file; None if a living process holds it."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(descriptor), path.stat(follow_symlinks=False)):
            return descriptor
    except OSError:
        pass
    os.close(descriptor)
    return None
