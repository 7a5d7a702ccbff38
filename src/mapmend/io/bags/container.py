"""The containers: ROS 1 bags, ROS 2 folders of sqlite3 or MCAP files, single MCAP files; read through rosbags."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mapmend.errors import InputError, MapmendError
from mapmend.io.bags.salvage import salvage, walk_mcap, walk_ros1, walk_sqlite
from mapmend.io.formats import BAG_DATABASE, BAG_FILE
from mapmend.scan import Note

ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC = b"#ROSBAG V", b"\x89MCAP0\r\n", b"SQLite format 3\0"
METADATA = "metadata.yaml"
EXTRA = "pip install 'mapmend[ros]'"

ROS1, MCAP, SQLITE, FOLDER = "ROS 1 bag", "MCAP file", "ROS 2 database", "ROS 2 bag"

LATEST_NS = 2**63 - 1  # a damaged time is limited to this

Message = tuple[str, int, bytes]
"""Topic, time of recording (ns), content."""


@dataclass(frozen=True)
class Topic:
    name: str
    type: str
    count: int


@dataclass
class Bag:
    """An open bag: its topics by name, and a stream of the messages of some of them in the order of recording."""

    path: Path
    kind: str
    topics: dict[str, Topic]
    stream: Callable[[Collection[str]], Iterator[Message]]
    notes: list[Note] = field(default_factory=list)

    @property
    def is_ros1(self) -> bool:
        return self.kind == ROS1

    def messages(self, names: Collection[str]) -> Iterator[Message]:
        """The messages of the topics; if the file is damaged, they end there, and a note says so."""
        source = self.stream(names)
        count = 0
        while True:
            try:
                topic, time_ns, raw = next(source)
            except StopIteration:
                return
            except Exception as error:  # a damaged file may raise anything in its reader
                self.notes.append(Note(f"the bag is damaged, and read up to there: {reason(error)}"))
                if not count:
                    raise InputError(self.path, f"is damaged: {reason(error)}", "copy or record it again") from None
                return
            count += 1
            yield topic, min(time_ns, LATEST_NS), raw


def bag_kind(path: str | Path) -> str | None:
    """The kind of bag at ``path``, by its content; None for anything else."""
    place = Path(path)
    try:
        if place.is_dir():
            return FOLDER if (place / METADATA).is_file() or storage_files(place) else None
        with place.open("rb") as stream:
            head = stream.read(16)
    except (OSError, ValueError):
        return None
    kinds = ((ROS1_MAGIC, ROS1), (MCAP_MAGIC, MCAP), (SQLITE_MAGIC, SQLITE))
    return next((kind for magic, kind in kinds if head.startswith(magic)), None)


def storage_files(folder: Path) -> list[Path]:
    """The files of a folder that hold messages, in the order of their names."""
    return sorted(file for file in folder.iterdir() if file.suffix in (BAG_FILE, BAG_DATABASE) and file.is_file())


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """The bag at ``path``; raises InputError if it cannot be opened, MapmendError if rosbags is not installed."""
    kind = bag_kind(path)
    if kind is None:
        raise InputError(path, "is no ROS bag", "name a .bag, a .mcap or a ROS 2 bag's folder")
    if kind == FOLDER and not (Path(path) / METADATA).is_file():
        yield _salvaged(Path(path), kind, f"it holds no {METADATA}")
        return
    reader = _reader(Path(path), kind)
    try:
        reader.open()
    except Exception as error:  # rosbags' own errors, and others that a damaged file causes
        yield _salvaged(Path(path), kind, reason(error))
        return
    try:
        yield Bag(Path(path), kind, _topics(reader.connections), _stream(reader))
    finally:
        reader.close()


def _reader(path: Path, kind: str) -> Any:
    """rosbags' reader for the kind, which follows from the content, not from the name."""
    try:
        if kind == ROS1:
            from rosbags.rosbag1 import Reader as Reader1

            return Reader1(path)
        from rosbags.rosbag2.reader import DirectoryReader
        from rosbags.rosbag2.storage_mcap import McapReader
        from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
    except ModuleNotFoundError as error:
        package = str(error.name).split(".", 1)[0]
        raise MapmendError(f"{path}: is a {kind}, and {package} is not installed; {EXTRA}") from None
    return {FOLDER: DirectoryReader, MCAP: McapReader, SQLITE: Sqlite3Reader}[kind](path)


def _salvaged(path: Path, kind: str, why: str) -> Bag:
    """The readable part of a bag that cannot be opened, with a note; raises InputError if there is none."""
    files = storage_files(path) if kind == FOLDER else [path]
    kinds = {bag_kind(file) for file in files}
    found = None
    if len(kinds) == 1 and (walk := _WALKS.get(str(kinds.pop()))):
        found = salvage(files, walk)
    if found is None or not found.counts:
        mend = "run rosbag reindex on it" if kind == ROS1 else "copy or record it again"
        raise InputError(path, f"is a {kind} that can't be opened: {why}", mend)
    topics = {name: Topic(name, found.types[name], found.counts.get(name, 0)) for name in sorted(found.types)}
    count = sum(found.counts.values())
    note = Note(f"the bag is cut off or damaged ({why}); the {count} messages up to there are used")
    return Bag(path, kind, topics, found.stream, [note])


_WALKS = {ROS1: walk_ros1, MCAP: walk_mcap, SQLITE: walk_sqlite}


def _topics(connections: Collection[Any]) -> dict[str, Topic]:
    """Several publishers of one topic count as one."""
    topics: dict[str, Topic] = {}
    for connection in connections:
        count = connection.msgcount + (topics[connection.topic].count if connection.topic in topics else 0)
        topics[connection.topic] = Topic(connection.topic, connection.msgtype, count)
    return dict(sorted(topics.items()))


def _stream(reader: Any) -> Callable[[Collection[str]], Iterator[Message]]:
    def messages(names: Collection[str]) -> Iterator[Message]:
        wanted = [connection for connection in reader.connections if connection.topic in names]
        if wanted:
            for connection, time_ns, raw in reader.messages(wanted, None, None):
                yield connection.topic, time_ns, raw

    return messages


def reason(error: Exception) -> str:
    """An error of a library in a few words."""
    text = str(error) or type(error).__name__
    return " ".join(text.split())[:160].rstrip(".")
