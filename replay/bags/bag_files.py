"""Bag reader: channels and raw messages, recovered if the index is broken.

`over_bag` hides the difference. The content decides the format: ROS 1 bag, ROS 2 folder, bare MCAP
or SQLite file.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, TypeVar

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, ConnectionExtRosbag2

from icreckon.replay.bags.records import LATEST, Channel, Record
from icreckon.replay.bags.recovery import MCAP_MAGIC, NO_DEFINITION, ROS1_MAGIC, RecordWalk
from icreckon.replay.bags.unpacking import Ros1Reader, Ros2Reader
from icreckon.replay.base.errors import ReplayError

SQLITE_MAGIC = b"SQLite format 3\0"
STORAGE_SUFFIXES = (".mcap", ".db3")

T = TypeVar("T")


class Bag(Protocol):
    """An open bag.

    Attributes:
        counts: number of messages of each channel.
        notes: findings for the user, such as a broken index.
    """

    counts: dict[Channel, int]
    notes: list[str]

    def messages(self, topics: Collection[str]) -> Iterator[Record]:
        """Yield the messages of some topics, roughly in the order of recording."""


def over_bag(path: Path, work: Callable[[Bag], T]) -> T:
    """Run a function over a bag, or over its recoverable part if the index is broken.

    Args:
        path: a ROS 1 bag, a ROS 2 folder, or a bare `.mcap` or `.db3` file.
        work: function of the bag; it may be called again from the start, with the bag opened by
            another method.

    Returns:
        The result of `work`.

    Raises:
        ReplayError: no such file, no bag, or nothing of it is readable.
    """
    reason = ""
    for files in _ways(path):
        try:
            with _IndexedBag(files) as bag:
                if reason:
                    bag.notes.append(f"{path.name}: {reason}; its files were read one by one")
                return work(bag)
        except _UnreadableError as problem:
            reason = reason or str(problem)
    return work(_RecoveredBag(path, reason))


class _UnreadableError(Exception):
    """rosbags cannot read the bag; the text is the reason."""


class _IndexedBag:
    """Bag with an intact index, read by rosbags."""

    def __init__(self, files: list[Path]) -> None:
        self.files = files
        self.counts: dict[Channel, int] = {}
        self.notes: list[str] = []
        self._stack = ExitStack()
        self._sources: list[tuple[rosbag1.Reader | rosbag2.Reader, list[Connection]]] = []

    def __enter__(self) -> Self:
        try:
            for file in self.files:
                ros1 = file.is_file() and _magic(file) == ROS1_MAGIC
                reader = Ros1Reader(file) if ros1 else Ros2Reader(file)
                self._stack.enter_context(reader)
                self._sources.append((reader, list(reader.connections)))
            self._count()
        except ReplayError as problem:
            self._stack.close()
            raise ReplayError(f"{file}: {problem}") from None
        except Exception as problem:
            self._stack.close()
            raise _UnreadableError(_reason(problem)) from problem
        self.notes.extend(_unread_sqlite_journals(self.files))
        return self

    def _count(self) -> None:
        for _, connections in self._sources:
            for connection in connections:
                channel = _channel(connection)
                self.counts[channel] = self.counts.get(channel, 0) + connection.msgcount

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def messages(self, topics: Collection[str]) -> Iterator[Record]:
        for reader, connections in self._sources:
            wanted = [connection for connection in connections if connection.topic in topics]
            if not wanted:
                continue
            channels = {connection.id: _channel(connection) for connection in wanted}
            listed, found = sum(connection.msgcount for connection in wanted), 0
            try:
                for connection, time, data in reader.messages(wanted):
                    if not 0 <= time < LATEST:
                        break
                    found += 1
                    yield Record(channels[connection.id], time, data)
            except ReplayError as problem:
                raise ReplayError(f"{reader.path}: {problem}") from None
            except Exception as problem:
                raise _UnreadableError(_reason(problem)) from problem
            if found != listed:
                raise _UnreadableError(f"the index lists {listed} messages, {found} are there")


class _RecoveredBag:
    """Readable part of a bag whose index is missing or broken."""

    def __init__(self, path: Path, reason: str) -> None:
        files = [path] if path.is_file() else _storage_files(path)
        self.counts: dict[Channel, int] = {}
        self.notes: list[str] = []
        self._walks: list[RecordWalk] = []
        for file in files:
            magic = _magic(file)
            if magic.startswith(SQLITE_MAGIC[: len(magic)]) and magic:
                raise ReplayError(
                    f"{file}: the SQLite file cannot be read ({reason}); "
                    "`sqlite3 broken.db3 .recover | sqlite3 saved.db3` may save what is left"
                )
            walk = RecordWalk(file)
            count = 0
            try:
                for record in walk.records():
                    self.counts[record.channel] = self.counts.get(record.channel, 0) + 1
                    count += 1
            except OSError as problem:
                raise ReplayError(f"{file}: cannot be read: {problem.strerror}") from None
            except ReplayError as problem:
                raise ReplayError(f"{file}: {problem}") from None
            for channel in walk.channels.values():
                self.counts.setdefault(channel, 0)
            self._walks.append(walk)
            self.notes.append(_recovery_note(walk, count, reason))
        if not any(self.counts.values()):
            raise ReplayError(f"{path}: no message can be read ({reason})")

    def messages(self, topics: Collection[str]) -> Iterator[Record]:
        for walk in self._walks:
            for record in walk.records():
                if record.channel.topic in topics:
                    yield record


def _recovery_note(walk: RecordWalk, count: int, reason: str) -> str:
    size = walk.path.stat().st_size
    if walk.complete:
        return f"{walk.path.name}: {reason}; all its {count} messages were read without the index"
    return (
        f"{walk.path.name}: {reason}; the file is cut short or damaged at byte {walk.position} of "
        f"{size}, {count} messages before that were read"
    )


def _ways(path: Path) -> list[list[Path]]:
    """Methods of opening the bag, each a list of files to open together."""
    if not path.exists():
        raise ReplayError(f"{path}: no such file or folder")
    try:
        if path.is_file():
            _check_is_bag(path)
            return [[path]]
        files = _storage_files(path)
        if not files:
            raise ReplayError(f"{path}: {_why_no_bag(path)}")
        for file in files:
            _check_is_bag(file)
    except OSError as problem:
        raise ReplayError(f"{path}: cannot be read: {problem.strerror}") from None
    # Of a bag that is compressed as a whole and was unpacked beside, rosbags would unpack all once more.
    return [files] if any(path.glob("*.zstd")) else [[path], files]


def _storage_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in STORAGE_SUFFIXES)


def _why_no_bag(folder: Path) -> str:
    if any(folder.glob("*.bag")):
        return "a folder of ROS 1 bags; give one of the .bag files, or several if they are one log"
    packed = sorted(file.name for file in folder.glob("*.zstd"))
    if packed:
        return f"a bag compressed as a whole; unpack it first: `unzstd {packed[0]}`"
    return "not a bag: the folder holds no .mcap and no .db3 file"


def _check_is_bag(file: Path) -> None:
    magic = _magic(file)
    if not magic:
        raise ReplayError(f"{file}: the file is empty")
    if magic.startswith(b"#ROSBAG V") and magic != ROS1_MAGIC:
        raise ReplayError(f"{file}: only version 2.0 of ROS 1 bags is read; try `rosbag migrate`")
    known = (ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC[: len(ROS1_MAGIC)])
    if not magic.startswith(known):
        raise ReplayError(f"{file}: not a bag (neither ROS 1 .bag, nor .mcap, nor .db3)")


def _magic(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(len(ROS1_MAGIC))


def _channel(connection: Connection) -> Channel:
    encoding = "ros1"
    if isinstance(connection.ext, ConnectionExtRosbag2):
        encoding = connection.ext.serialization_format
    # SQLite holds values of any type in any column.
    texts: tuple[object, ...] = (connection.topic, connection.msgtype, encoding)
    for text in texts:
        if not isinstance(text, str):
            raise rosbag2.ReaderError(
                f"the name or type of a topic is no text but {str(text)[:40]}"
            )
    data: object = connection.msgdef.data
    definition = connection.msgdef if isinstance(data, str) else NO_DEFINITION
    return Channel(connection.topic, connection.msgtype, definition, encoding)


def _unread_sqlite_journals(files: list[Path]) -> list[str]:
    databases = [
        database
        for file in files
        for database in (_storage_files(file) if file.is_dir() else [file])
        if database.suffix == ".db3"
    ]
    return [
        f"{journal.name}: holds messages that were never merged into {database.name} and were not "
        f"read; `sqlite3 {database.name} 'PRAGMA wal_checkpoint'` merges them"
        for database in databases
        if (journal := database.with_name(f"{database.name}-wal")).is_file()
        and journal.stat().st_size
    ]


def _reason(problem: Exception) -> str:
    """One-line message of an error of rosbags, or its type if the message is unclear."""
    text = " ".join(str(problem).split()).rstrip(".")
    if isinstance(problem, (rosbag1.ReaderError, rosbag2.ReaderError)) and text:
        return text
    return f"{type(problem).__name__}: {text}" if text else type(problem).__name__
