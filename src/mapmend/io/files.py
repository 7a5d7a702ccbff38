"""The bytes of a file, decompressed if its content (not its name) shows that it is compressed."""

from __future__ import annotations

import bz2
import gzip
import zlib
from pathlib import Path

from mapmend.errors import InputError

_GZIP, _BZIP2 = b"\x1f\x8b", b"BZh"


def read_bytes(path: str | Path) -> bytes:
    """The content of a plain, ``.gz`` or ``.bz2`` file; raises InputError if it cannot be opened or decompressed."""
    try:
        packed = Path(path).read_bytes()
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


def open_text(path: str | Path) -> str:
    """The content as text, line ends as ``\\n``; raises InputError if it is not text."""
    return decode(read_bytes(path), path)


def decode(data: bytes, path: str | Path) -> str:
    """``data`` as UTF-8 text; raises InputError that names ``path`` if it is not."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(path, "is not text", "name a log, a graph, a trajectory, relations or a map") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _unpack_bzip2(packed: bytes) -> bytes:
    """Like ``bz2.decompress``, but refuses a file that was cut at the start of a stream."""
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
