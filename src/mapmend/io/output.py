"""Writing of outputs: they appear whole or not at all, and replace only what mapmend wrote.

A file is made beside its place and renamed into it. A folder is made beside its place and put there in one step, and
other people's files in it are kept (`mapmend.io.swap`). Links are followed; devices and pipes are written to.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from mapmend.errors import OutputError
from mapmend.interrupts import uninterrupted
from mapmend.io import staging as hidden
from mapmend.io import swap
from mapmend.io.formats import BAG_DATABASE, BAG_FILE
from mapmend.io.own_files import RUN_FILE, RUN_FILES, is_own_content, older_files, own_files
from mapmend.io.staging import HIDDEN, Staging

READ_IN_FOLDERS = (*RUN_FILES, "tune.json", "metadata.yaml")
READ_SUFFIXES = (BAG_FILE, BAG_DATABASE)
"""The files that are read if a RUN or a ROS bag is named."""

_MOST_LINKS = 40  # as many as Linux follows


def write_whole(path: str | Path, content: bytes | str) -> None:
    """Write a file beside its place and rename it into it; raises OutputError, leaving nothing behind.

    A link stays, and its target is written; a device, a pipe or an open file of this process is written to. The new
    file gets the permissions of the one that it replaces.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        place = _place_of(Path(path))
        if place is None:
            _write_through(Path(path), data)
            return
        swap.sweep(place.parent)
        with hidden.hidden_file(place.parent, place.name) as (descriptor, temporary):
            hidden.write_all(descriptor, data)
            _hand_on_owner(place, descriptor)
            os.fsync(descriptor)
            with uninterrupted():
                os.rename(temporary, place)
                hidden.sync_folder(place.parent)
                swap.remember(path, place)
    except (OSError, ValueError) as error:
        raise not_written(Path(path), error) from None


def write_own(path: str | Path, content: bytes | str) -> None:
    """The same for a file whose name mapmend chose: it replaces only a file that mapmend wrote. Makes its folder."""
    check_own_writable(path)
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(Path(path), error) from None
    write_whole(path, content)


def check_file_writable(path: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """Raise OutputError now if `write_whole` could not put a file at ``path``: before long work starts.

    ``inputs``: files and folders that are read; an output that is one of them, or belongs to one, would destroy it.
    """
    target = Path(path)
    try:
        place = _place_of(target)
        for source in map(Path, inputs):
            if place is not None and place.exists() and _is_of(place, source):
                raise OutputError(f"{target}: is the input; name another file")
        if place is None or place.exists():
            _check_access(target)
        if place is not None:
            _check_takes_files(place.parent)
    except (OSError, ValueError) as error:
        raise not_written(target, error) from None


def check_own_writable(path: str | Path) -> None:
    """Raise OutputError now if `write_own` could not put a file at ``path``."""
    target = Path(path)
    try:
        if target.is_file() and not is_own_content(target):
            raise OutputError(f"{target}: is there, and not by mapmend; name another folder, or move that file away")
        if target.parent.exists():
            check_file_writable(target)
        else:
            _check_takes_files(_nearest_existing(target.absolute().parent))
    except (OSError, ValueError) as error:
        raise not_written(target, error) from None


def check_writable(directory: str | Path, names: Iterable[str] = ()) -> None:
    """Raise OutputError now if `whole_or_nothing` could not put an output at ``directory``: before long work starts.

    ``names``: the files that will be written, relative to the folder. What a killed process left there is swept first.
    """
    target = Path(directory)
    try:
        place = target.resolve()
        _sweep_about(place)
        _check_free(target, place, names)
        _check_takes_files(_nearest_existing(_parent_of_staging(place)))
        if place.exists():
            _check_access(target)
    except (OSError, ValueError, RuntimeError) as error:
        raise not_written(target, error) from None


class OutputFolder:
    """An output folder that is being made: the files are written into ``path``, `write_run_json` comes last."""

    def __init__(self, path: Path, target: Path) -> None:
        self.path = path
        self._target = target

    def write_run_json(self, values: dict[str, Any]) -> dict[str, Any]:
        """Write run.json and return its content: ``values``, and ``files``, which mapmend may replace later.

        ``files`` also names what mapmend wrote there before and what is still there. ``older_files`` gives the sha256
        of files, reports for instance, that fit what was there before and not what is written now.
        """
        written = {*swap.files_in(self.path), RUN_FILE}
        own = own_files(self._target) if self._target.is_dir() else frozenset()
        kept = {name for name in own if (self._target / name).is_file()}
        run_json = {**values, "files": sorted(written | kept)}
        older = older_files(self._target, own, written)
        if older:
            run_json["older_files"] = older
        write_whole(self.path / RUN_FILE, json.dumps(run_json, indent=2, allow_nan=False) + "\n")
        return run_json


@contextmanager
def whole_or_nothing(directory: str | Path, names: Iterable[str] = ()) -> Iterator[OutputFolder]:
    """Give a folder to write into, which is put at ``directory`` at the end; after a failure nothing of it is left.

    Files that are there already stay; of those that the older run.json lists, the ones with the new files' names are
    replaced. Raises OutputError where another file has such a name, or run.json is another program's.
    """
    check_writable(directory, names)
    place = Path(directory).resolve()
    try:
        _make_folder(place.parent)
        staging = Staging(_parent_of_staging(place), place.name)
    except OSError as error:
        raise not_written(Path(directory), error) from None
    try:
        yield OutputFolder(staging.new, place)
        _check_free(Path(directory), place, swap.files_in(staging.new))
        swap.put_in_place(staging, place)
    except OSError as error:
        raise not_written(Path(directory), error) from None
    except OutputError as error:  # about a file in the hidden folder, whose name says nothing to the user
        raise OutputError(str(error).replace(str(staging.new), str(directory))) from None
    finally:
        swap.close(staging)


@contextmanager
def made_beside(path: str | Path) -> Iterator[Path]:
    """Give a hidden folder beside a file's or folder's place; gone at the end. OSError within becomes OutputError."""
    try:
        parent = Path(path).resolve().parent
        swap.sweep(parent)
        staging = Staging(parent, Path(path).name)
    except (OSError, RuntimeError) as error:
        raise not_written(Path(path), error) from None
    try:
        yield staging.new
    except OSError as error:
        raise not_written(Path(path), error) from None
    finally:
        swap.close(staging)


def move_file(made: Path, path: str | Path) -> None:
    """Put a file from `made_beside` at ``path``, as `write_whole` does; raises OSError."""
    place = _place_of(Path(path))
    if place is None:
        with made.open("rb") as source, Path(path).open("wb") as target:
            shutil.copyfileobj(source, target)
        return
    with made.open("rb+") as stream:
        _hand_on_owner(place, stream.fileno())
        os.fsync(stream.fileno())
    with uninterrupted():
        os.rename(made, place)
        hidden.sync_folder(place.parent)
        swap.remember(path, place)


def move_folder(made: Path, path: str | Path) -> None:
    """Put a folder from `made_beside` at ``path``, where nothing or an empty folder is; raises OSError."""
    place = Path(path).resolve()
    hidden.sync_tree(made)
    made.chmod(0o777 & ~hidden.umask())
    with uninterrupted():
        os.rename(made, place)
        hidden.sync_folder(place.parent)
        swap.remember(path, place)


def finish_interrupted(folder: str | Path) -> None:
    """Before ``folder`` is read: finish the renaming that a killed process had begun there."""
    place = Path(folder).resolve()
    if place.is_dir():
        swap.sweep(place)


def not_written(target: Path, error: Exception) -> OutputError:
    """An error of the system in one line."""
    reason = (getattr(error, "strerror", None) or str(error)).splitlines()[0]
    return OutputError(f"{target}: can't be written ({reason}); choose a place that can")


def _place_of(path: Path) -> Path | None:
    """The regular file that a path leads to or will make; None for a device, pipe or open file. Raises OutputError."""
    if path.is_dir():
        raise OutputError(f"{path}: is a directory; name a file")
    if _own_descriptor(path) is not None or (path.exists() and not path.is_file()):
        return None
    place = Path(os.path.realpath(path))
    if place.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    return place


def _own_descriptor(path: Path) -> int | None:
    """The descriptor of this process that a path such as /dev/stdout stands for."""
    pattern = re.compile(rf"(?:/proc/{os.getpid()}(?:/task/\d+)?|/dev)/fd/(\d+)")
    text = os.path.abspath(path)
    for _ in range(_MOST_LINKS):
        folder, name = os.path.split(text)
        found = pattern.fullmatch(os.path.join(os.path.realpath(folder), name))
        if found is not None:
            return int(found[1])
        if not os.path.islink(text):
            break
        text = os.path.abspath(os.path.join(os.path.realpath(folder), os.readlink(text)))
    return None


def _write_through(path: Path, data: bytes) -> None:
    """Write to a device or pipe; to an open file at this process's current position."""
    number = _own_descriptor(path)
    if number is not None:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        hidden.write_all(number, data)
        return
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        hidden.write_all(descriptor, data)
    finally:
        os.close(descriptor)


def _hand_on_owner(place: Path, descriptor: int) -> None:
    """Give a new file the permissions and, where this user may, the owner of the one that it replaces."""
    try:
        older = place.stat()
    except FileNotFoundError:
        os.fchmod(descriptor, 0o666 & ~hidden.umask())
        return
    with suppress(PermissionError):
        os.fchown(descriptor, older.st_uid, older.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(older.st_mode))


def _is_of(place: Path, source: Path) -> bool:
    """Whether a file is what is read at ``source``, or belongs to the RUN or the bag there."""
    if not source.is_dir():
        return source.exists() and place.samefile(source)
    is_read = place.name in READ_IN_FOLDERS or place.suffix in READ_SUFFIXES
    return is_read and place.parent.samefile(source)


def _check_free(target: Path, place: Path, names: Iterable[str]) -> None:
    """Raise OutputError if files of these names would replace files of others in a folder."""
    if not os.path.lexists(place):
        return
    if not place.is_dir():
        raise OutputError(f"{target}: is a file; name a folder")
    own = own_files(place)
    for name in names:
        for above in list(Path(name).parents)[-2::-1]:
            if os.path.lexists(place / above) and ((place / above).is_symlink() or not (place / above).is_dir()):
                raise _foreign(target / above)
        file = place / name
        if os.path.lexists(file):
            if file.is_symlink():
                raise OutputError(f"{target / name}: is a link; name another folder, or remove the link")
            if name not in own or not file.is_file():
                raise _foreign(target / name)
            _check_access(file)


def _foreign(path: Path) -> OutputError:
    what = f"is there, and {RUN_FILE} does not list it as mapmend's"
    return OutputError(f"{path}: {what}; name another folder, or move it away")


def _parent_of_staging(place: Path) -> Path:
    """The folder beside the output; the output itself if a file system begins there or the parent is not writable."""
    if place.is_dir() and (place.is_mount() or not os.access(place.parent, os.W_OK | os.X_OK)):
        return place
    return place.parent


def _make_folder(folder: Path) -> None:
    """Make a folder with those above it, but never a hidden one: one that is gone was swept, its process is dead."""
    if any(HIDDEN.fullmatch(part) for part in folder.parts) and not folder.is_dir():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder))
    folder.mkdir(parents=True, exist_ok=True)


def _sweep_about(place: Path) -> None:
    swap.sweep(place.parent)
    if place.is_dir():
        swap.sweep(place)


def _check_access(target: Path) -> None:
    if not os.access(target, os.W_OK):
        raise OutputError(f"{target}: is write-protected; choose another place, or allow writing")


def _check_takes_files(folder: Path) -> None:
    with tempfile.TemporaryFile(dir=folder):
        pass


def _nearest_existing(folder: Path) -> Path:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder
