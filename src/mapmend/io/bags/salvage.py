"""Reading of a bag whose recorder was switched off, or whose copy was interrupted, from its beginning.

Such a file lacks the index at its end, without which no reader opens it, but the messages before it are complete. MCAP:
mcap.dev/spec. ROS 1: wiki.ros.org/Bags/Format/2.0. Both are sequences of records, some of them compressed in chunks.
"""

from __future__ import annotations

import bz2
import sqlite3
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

Message = tuple[str, int, bytes]

_MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE, _MCAP_CHUNK, _MCAP_DATA_END = 3, 4, 5, 6, 15
_ROS1_MESSAGE, _ROS1_CHUNK, _ROS1_CONNECTION = 2, 5, 7
_LARGEST_RECORD = 1 << 30


@dataclass(frozen=True)
class Salvaged:
    """Types and numbers of messages by topic, and the messages of some of the topics, in the order of the file."""

    types: dict[str, str]
    counts: dict[str, int]
    stream: Callable[[Collection[str]], Iterator[Message]]


class _Topics:
    """Topic names and types by the numbers that stand for them in the file."""

    def __init__(self) -> None:
        self.schemas: dict[int, str] = {}
        self.names: dict[int, str] = {}
        self.types: dict[str, str] = {}

    def add(self, number: int, name: str, kind: str) -> None:
        self.names[number] = name
        self.types[name] = kind


Walk = Callable[[Path, _Topics], Iterator[Message]]


def salvage(files: list[Path], walk: Walk) -> Salvaged:
    """Reads the files once to count, and again for each stream."""
    topics = _Topics()
    counts: Counter[str] = Counter()
    for file in files:
        counts.update(name for name, _, _ in walk(file, topics))

    def stream(names: Collection[str]) -> Iterator[Message]:
        for file in files:
            for message in walk(file, _Topics()):
                if message[0] in names:
                    yield message

    return Salvaged(topics.types, dict(counts), stream)


def walk_mcap(path: Path, topics: _Topics) -> Iterator[Message]:
    """The messages of an incomplete MCAP file."""
    with path.open("rb") as stream:
        stream.seek(8)  # the magic
        yield from _mcap_messages(stream, topics)


def _mcap_messages(stream: BinaryIO, topics: _Topics) -> Iterator[Message]:
    while head := stream.read(9):
        if len(head) < 9:
            return
        code, length = struct.unpack("<BQ", head)
        if code == _MCAP_DATA_END or length > _LARGEST_RECORD:
            return
        body = stream.read(length)
        if code == _MCAP_CHUNK:
            yield from _mcap_messages(BytesIO(_mcap_unpacked(body)), topics)
        if len(body) < length:
            return
        if code == _MCAP_SCHEMA:
            topics.schemas[struct.unpack_from("<H", body)[0]] = _text(body, 2)[0]
        elif code == _MCAP_CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topics.add(number, _text(body, 4)[0], topics.schemas.get(schema, ""))
        elif code == _MCAP_MESSAGE:
            number, _, time_ns = struct.unpack_from("<HIQ", body)
            if number in topics.names:
                yield topics.names[number], time_ns, body[22:]


def _mcap_unpacked(body: bytes) -> bytes:
    """The records in a chunk; of an incomplete chunk, those that are there."""
    if len(body) < 32:
        return b""
    packing, at = _text(body, 28)
    return _unpacked(packing, body[at + 8 :])


def _text(body: bytes, at: int) -> tuple[str, int]:
    length = struct.unpack_from("<I", body, at)[0]
    return body[at + 4 : at + 4 + length].decode("utf-8", "replace"), at + 4 + length


def _unpacked(packing: str, data: bytes) -> bytes:
    """The part of the data that can be decompressed; the data may end too early."""
    if packing in ("", "none"):
        return data
    try:
        return bytes(_unpacker(packing).decompress(data))
    except Exception:  # each library has errors of its own for damaged data
        return b""


def _unpacker(packing: str) -> Any:
    if packing == "bz2":
        return bz2.BZ2Decompressor()
    if packing == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor()
    try:
        from compression.zstd import ZstdDecompressor  # type: ignore[import-not-found,unused-ignore]
    except ModuleNotFoundError:
        from backports.zstd import ZstdDecompressor
    return ZstdDecompressor()


def walk_ros1(path: Path, topics: _Topics) -> Iterator[Message]:
    """The messages of an incomplete ROS 1 bag."""
    with path.open("rb") as stream:
        stream.readline()
        yield from _ros1_messages(stream, topics)


def _ros1_messages(stream: BinaryIO, topics: _Topics) -> Iterator[Message]:
    while True:
        header, whole = _sized(stream)
        if not whole:
            return
        fields = _fields(header)
        data, whole = _sized(stream)
        code = fields.get("op", b"\0")[0]
        if code == _ROS1_CHUNK:
            packing = fields.get("compression", b"none").decode("latin-1")
            yield from _ros1_messages(BytesIO(_unpacked(packing, data)), topics)
        if not whole:
            return
        if code == _ROS1_CONNECTION and len(fields.get("conn", b"")) == 4:
            kind = _fields(data).get("type", b"").decode("latin-1")
            package, _, name = kind.partition("/")
            topic = fields.get("topic", b"").decode("utf-8", "replace")
            topics.add(struct.unpack("<I", fields["conn"])[0], topic, f"{package}/msg/{name}")
        elif code == _ROS1_MESSAGE and len(fields.get("conn", b"")) == 4 and len(fields.get("time", b"")) == 8:
            number = struct.unpack("<I", fields["conn"])[0]
            seconds, nanoseconds = struct.unpack("<II", fields["time"])
            if number in topics.names:
                yield topics.names[number], seconds * 1_000_000_000 + nanoseconds, data


def _sized(stream: BinaryIO) -> tuple[bytes, bool]:
    """Bytes that follow their count, and whether all of them are there."""
    head = stream.read(4)
    if len(head) < 4:
        return b"", False
    length = struct.unpack("<I", head)[0]
    data = stream.read(length)
    return data, len(data) == length


def _fields(header: bytes) -> dict[str, bytes]:
    fields, at = {}, 0
    while at + 4 <= len(header):
        length = struct.unpack_from("<I", header, at)[0]
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name.decode("latin-1")] = value
        at += 4 + length
    return fields


def walk_sqlite(path: Path, topics: _Topics) -> Iterator[Message]:
    """The messages of a ROS 2 database in the order in which they were written, up to the first missing page."""
    try:
        base = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
    except sqlite3.Error:
        return
    try:
        # SQLite refuses a file that is shorter than its header says, except in this mode for repair.
        base.execute("PRAGMA writable_schema = ON")
        for number, name, kind in base.execute("SELECT id, name, type FROM topics"):
            topics.add(number, name, kind)
        for number, time_ns, data in base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            if number in topics.names:
                yield topics.names[number], time_ns, data
    except sqlite3.Error:
        return
    finally:
        base.close()
