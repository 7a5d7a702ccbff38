"""Results that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mapmend.errors import OutputError

RUN_FILE = "run.json"  # what tells a folder of ours


def write_whole(path: str | Path, content: bytes | str) -> None:
    """Write a file beside its place and rename it into it; raises OutputError, leaving nothing behind."""
    target = Path(path)
    data = content.encode() if isinstance(content, str) else content
    temporary: Path | None = None
    try:
        if target.is_dir():
            raise OutputError(f"{target}: is a directory; name a file")
        descriptor, name = tempfile.mkstemp(prefix=f".{target.name[:40]}.", dir=target.parent)
        temporary = Path(name)
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)
    except (OSError, ValueError) as error:
        raise _not_written(target, error) from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def check_writable(directory: str | Path) -> None:
    """Raise OutputError now if `whole_or_nothing` could not put a RUN at ``directory``: before long work starts."""
    target = Path(directory)
    _check_replaceable(target)
    parent = _nearest_existing(target.absolute().parent)
    try:
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise _not_written(target, error) from None


def check_file_writable(path: str | Path) -> None:
    """Raise OutputError now if `write_whole` could not put a file at ``path``: before long work starts."""
    target = Path(path)
    try:
        if target.is_dir():
            raise OutputError(f"{target}: is a directory; name a file")
        with tempfile.TemporaryFile(dir=target.parent):
            pass
    except (OSError, ValueError) as error:
        raise _not_written(target, error) from None


@contextmanager
def whole_or_nothing(directory: str | Path) -> Iterator[Path]:
    """Give a folder to write into, which becomes ``directory`` at the end; after any failure nothing of it is left.

    Replaces an empty folder or a RUN of ours (one that holds a run.json); raises OutputError for any other.
    """
    check_writable(directory)
    target = Path(directory).absolute()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name[:40]}.", dir=target.parent))
        temporary.chmod(0o777 & ~_umask())
    except OSError as error:
        raise _not_written(target, error) from None
    try:
        yield temporary
        _move_into_place(temporary, target)
    except OSError as error:
        raise _not_written(target, error) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_into_place(temporary: Path, target: Path) -> None:
    """Rename; an older RUN steps aside first, and comes back if the renaming fails."""
    _check_replaceable(target)
    if not target.exists():
        temporary.replace(target)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name[:40]}.old.", dir=target.parent))
    try:
        target.replace(aside / "run")
        try:
            temporary.replace(target)
        except BaseException:
            (aside / "run").replace(target)
            raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _check_replaceable(target: Path) -> None:
    try:
        if not os.path.lexists(target):
            return
        if not target.is_dir():
            raise OutputError(f"{target}: is a file; name a folder")
        if any(target.iterdir()) and not (target / RUN_FILE).is_file():
            raise OutputError(f"{target}: holds other files and no {RUN_FILE}; name a new or empty folder")
    except (OSError, ValueError) as error:
        raise _not_written(target, error) from None


def _nearest_existing(folder: Path) -> Path:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


def _not_written(target: Path, error: Exception) -> OutputError:
    reason = (getattr(error, "strerror", None) or str(error)).splitlines()[0]
    return OutputError(f"{target}: can't be written ({reason}); choose a place that can")


def _umask() -> int:
    """The user's mask, which temporary files ignore."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
