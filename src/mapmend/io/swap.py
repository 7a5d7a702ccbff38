"""How a new output folder replaces an older one in one step, while everything else in the folder is kept.

If the system can exchange two names (Linux: renameat2), the new folder is completed with hard links to all other files
of the older one, and the two names are exchanged at once; then the older folder is removed. If that is not possible,
the files are renamed into the folder one by one, run.json last. Before this, a plan is written, with which the next
command finishes the work of a killed one.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from mapmend.interrupts import PLACED, uninterrupted
from mapmend.io import staging as hidden
from mapmend.io.own_files import RUN_FILE, is_name
from mapmend.io.staging import HIDDEN, Staging

EXCHANGE, RENAME = "exchange", "rename"
MOST_LINKS = 10_000
"""A folder that holds more besides the output is left where it is, and the files are renamed into it."""

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_NO_EXCHANGE = {
    errno.ENOSYS, errno.EINVAL, errno.EOPNOTSUPP,  # the system or the file system can't exchange or link
    errno.EBUSY, errno.EXDEV,  # a file system begins at the folder or within it
    errno.EPERM, errno.EACCES, errno.EMLINK,  # something in the folder may not be linked or read
}  # fmt: skip


def put_in_place(staging: Staging, target: Path) -> None:
    """Make what is in ``staging.new`` the output folder ``target``, which may be there; raises OSError.

    If this process is killed at any point, all of the older files or all of the new ones remain, and all others. After
    renaming one by one, this holds when the next command has called `sweep`.
    """
    _drop_hidden(staging.new)
    hidden.sync_tree(staging.new)
    with uninterrupted():
        names = files_in(staging.new)
        if not target.exists() and _renamed(staging.new, target):
            hidden.sync_folder(target.parent)
        elif not _exchanged(staging, target, names):
            _rename_each(staging, target, names)
        remember(target, target)


def remember(name: str | Path, place: Path) -> None:
    """Record that an output is in its place; a path in a hidden folder is not."""
    if not any(HIDDEN.fullmatch(part) for part in place.parts):
        PLACED.append(str(name))


def files_in(folder: Path) -> list[str]:
    """All files below a folder, relative to it, run.json last."""
    names = []
    for place, below, files in os.walk(folder):
        below[:] = [name for name in below if not HIDDEN.fullmatch(name)]
        names += [(Path(place) / name).relative_to(folder).as_posix() for name in files if not HIDDEN.fullmatch(name)]
    return sorted(names, key=lambda name: (name == RUN_FILE, name))


def sweep(folder: Path) -> None:
    """Remove the hidden files and folders that killed processes of this user left in ``folder``.

    An output that was being renamed into its place is finished. What cannot be removed stays for the next time.
    """
    with suppress(OSError):
        for entry in list(os.scandir(folder)):
            if not HIDDEN.fullmatch(entry.name):
                continue
            with suppress(OSError, ValueError, LookupError):
                if entry.stat(follow_symlinks=False).st_uid != os.geteuid():
                    continue
                if entry.is_dir(follow_symlinks=False):
                    with hidden.dead_folder(Path(entry.path)) as is_dead:
                        if is_dead:
                            finish(Path(entry.path))
                elif entry.is_file(follow_symlinks=False) and hidden.is_dead_file(Path(entry.path)):
                    os.unlink(entry.path)


def close(staging: Staging) -> None:
    """End a staging after success or failure; what cannot be removed is left to `sweep`."""
    with uninterrupted():
        try:
            with suppress(OSError, ValueError, LookupError):
                finish(staging.path)
        finally:
            staging.release()


def finish(folder: Path) -> None:
    """Finish the plan of a hidden folder and remove the folder; raises OSError, ValueError for an invalid plan."""
    plan = hidden.read_plan(folder)
    new = hidden.new_of(folder)
    if plan is not None:
        names, target = plan["names"], str(plan["target"])
        if not isinstance(names, list) or not all(map(is_name, [*names, target])):
            raise ValueError(f"{folder}: holds no plan of mapmend's")
        if plan["how"] == RENAME:
            for name in names:
                if os.path.lexists(new / name):
                    (folder.parent / name).parent.mkdir(parents=True, exist_ok=True)
                    os.rename(new / name, folder.parent / name)
            for place in {(folder.parent / name).parent for name in names}:
                hidden.sync_folder(place)
        else:
            _clear_exchanged(new, folder.parent / target, set(names), plan["links"])
    _remove_tree(new)
    hidden.remove_emptied(folder)


def _remove_tree(folder: Path) -> None:
    """Remove a folder of ours that may hold copies of other people's folders, which may be write-protected."""
    for place, _, _ in os.walk(folder):
        os.chmod(place, 0o700)
    if folder.exists():
        shutil.rmtree(folder)


def _drop_hidden(folder: Path) -> None:
    """Remove the files that a killed child process left in the new output."""
    for place, folders, files in os.walk(folder):
        for name in filter(HIDDEN.fullmatch, folders):
            shutil.rmtree(Path(place) / name)
        for name in filter(HIDDEN.fullmatch, files):
            (Path(place) / name).unlink()
        folders[:] = [name for name in folders if not HIDDEN.fullmatch(name)]


def _renamed(new: Path, target: Path) -> bool:
    """Rename ``new`` to ``target``; returns False if another process has made a folder there in the meantime."""
    try:
        os.rename(new, target)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            return False
        raise
    return True


def _exchanged(staging: Staging, target: Path, names: list[str]) -> bool:
    """Complete the new folder with everything else in ``target`` and exchange the two; False if this is impossible.

    A shell whose working directory is the folder would be left in the older one, so then this is impossible too.
    """
    if staging.path.parent != target.parent or _is_working_directory(target):
        return False
    try:
        links = _link_missing(target, staging.new)
        os.utime(staging.new)
        plan = {"how": EXCHANGE, "target": target.name, "names": names, "links": links}
        hidden.write_plan(staging.path, plan)
        exchange(staging.new, target)
    except OSError as error:
        if error.errno in _NO_EXCHANGE:
            return False
        raise
    hidden.sync_folder(target.parent)
    hidden.sync_folder(staging.path)
    return True


def exchange(one: Path, other: Path) -> None:
    """Exchange two names of one file system, in one step; raises OSError, ENOSYS if the system cannot do this."""
    import ctypes

    renameat2: Any = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if renameat2 is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    if renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(other))


def _is_working_directory(target: Path) -> bool:
    try:
        return Path.cwd().resolve().is_relative_to(target)
    except OSError:
        return False


def _link_missing(old: Path, new: Path) -> dict[str, int]:
    """Link each file of ``old`` that ``new`` lacks into it, folders made alike: the links' inodes by their names."""
    links: dict[str, int] = {}
    _link_folder(old, new, "", links)
    return links


def _link_folder(old: Path, new: Path, below: str, links: dict[str, int]) -> None:
    device = old.stat().st_dev
    for entry in os.scandir(old / below):
        name = f"{below}{entry.name}"
        if entry.is_dir(follow_symlinks=False):
            if entry.stat(follow_symlinks=False).st_dev != device:
                raise OSError(errno.EXDEV, os.strerror(errno.EXDEV), str(old / name))
            if HIDDEN.fullmatch(entry.name):  # another process is renaming its files into the folder
                raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), str(old / name))
            (new / name).mkdir(exist_ok=True)
            _link_folder(old, new, f"{name}/", links)
        elif not os.path.lexists(new / name):
            if len(links) >= MOST_LINKS:
                raise OSError(errno.EMLINK, os.strerror(errno.EMLINK), str(old))
            os.link(old / name, new / name, follow_symlinks=False)
            links[name] = entry.inode()
    shutil.copystat(old / below, new / below)
    was, now = (old / below).stat(), (new / below).stat()
    if (was.st_uid, was.st_gid) != (now.st_uid, now.st_gid):
        os.chown(new / below, was.st_uid, was.st_gid)


def _clear_exchanged(left: Path, target: Path, names: set[str], links: dict[str, int]) -> None:
    """Remove the files that have a successor or a link in ``target``, before the exchange or after it.

    Any other file was made in the older folder during the exchange: it is moved to ``target``.
    """
    for folder, below, files in os.walk(left):
        os.chmod(folder, 0o700)  # the new folder already has the mode of a write-protected one
        for path in (Path(folder) / name for name in (*files, *below)):
            if path.is_dir() and not path.is_symlink():
                continue
            name = path.relative_to(left).as_posix()
            inode = path.stat(follow_symlinks=False).st_ino
            if name in names or links.get(name) == inode:
                path.unlink()
                continue
            place = target / name
            if os.path.lexists(place) and place.stat(follow_symlinks=False).st_ino != links.get(name):
                raise FileExistsError(errno.EEXIST, "two programs wrote it at once", str(place))
            place.parent.mkdir(parents=True, exist_ok=True)
            os.rename(path, place)


def _rename_each(staging: Staging, target: Path, names: Iterable[str]) -> None:
    """Move the staging into ``target``, write the plan, and rename file by file."""
    inside = staging
    if staging.path.parent != target:
        place = target / staging.path.name
        try:
            os.rename(staging.path, place)
            staging.path = place
        except OSError as error:
            if error.errno != errno.EXDEV:
                raise
            inside = _copied(staging, target, names)
    try:
        hidden.write_plan(inside.path, {"how": RENAME, "target": target.name, "names": list(names)})
        finish(inside.path)
    finally:
        if inside is not staging:
            inside.release()


def _copied(staging: Staging, target: Path, names: Iterable[str]) -> Staging:
    """The same files in a staging within ``target``, where another file system begins."""
    inside = Staging(target, target.name)
    for name in names:
        (inside.new / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(staging.new / name, inside.new / name)
    hidden.sync_tree(inside.new)
    return inside
