"""Bytes of a file, unpacked where it is an archive, which its content tells, not its name."""

from __future__ import annotations

import bz2
import gzip
import zlib
from pathlib import Path

from mapmend.datasets.cache import fetched_path
from mapmend.errors import InputError

_GZIP, _BZIP2 = b"\x1f\x8b", b"BZh"


def read_bytes(path: str | Path) -> bytes:
    """The content of a plain, ``.gz`` or ``.bz2`` file, or of a fetched public log by its name.

    Raises InputError for what can't be opened or unpacked.
    """
    try:
        packed = _place(path).read_bytes()
    except FileNotFoundError:
        raise InputError(path, "no such file", "check the path") from None
    except IsADirectoryError:
        raise InputError(path, "is a directory", "name a file in it") from None
    except PermissionError:
        raise InputError(path, "may not be read", "check the file's permissions") from None
    except (OSError, ValueError) as error:
        raise InputError(path, f"can't be read: {_reason(error)}", "check the path") from None
    try:
        if packed.startswith(_GZIP):
            return gzip.decompress(packed)
        if packed.startswith(_BZIP2):
            return _unpack_bzip2(packed)
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise InputError(path, f"broken archive: {_reason(error)}", "fetch or pack the file again") from None
    return packed


def _place(path: str | Path) -> Path:
    """The path itself, or where a public log of that name lies; a file that is there comes first."""
    if Path(path).exists():
        return Path(path)
    return fetched_path(path) or Path(path)


def open_text(path: str | Path) -> str:
    """The content as text, line ends as ``\\n``; raises InputError where it is no text."""
    return decode(read_bytes(path), path)


def decode(data: bytes, path: str | Path) -> str:
    """``data`` as UTF-8 text; raises InputError naming ``path`` where it is none."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(path, "is not text", "name a log, a graph, a trajectory, relations or a map") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _unpack_bzip2(packed: bytes) -> bytes:
    """Like ``bz2.decompress``, which takes a file cut at a stream's start for a whole one."""
    pieces = []
    while packed:
        unpacker = bz2.BZ2Decompressor()
        pieces.append(unpacker.decompress(packed))
        if not unpacker.eof:
            raise EOFError("it ends too early")
        packed = unpacker.unused_data
        if not packed.startswith(_BZIP2):
            break
    return pieces[0] if len(pieces) == 1 else b"".join(pieces)


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return text.splitlines()[0].rstrip(".")
