"""Bag reader: channels and raw messages, recovered if the index is broken.

`over_bag` hides the difference. The content decides the format: ROS 1 bag, ROS 2 folder, bare MCAP
or SQLite file. Files that are compressed as a whole are unpacked first.
"""

from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Protocol, Self, TypeVar

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.reader import DirectoryReader

from icreckon.replay.bags.records import LATEST, Channel, Record
from icreckon.replay.bags.recovery import MCAP_MAGIC, ROS1_MAGIC, RecordWalk
from icreckon.replay.bags.unpacking import limit, unpack, unpack_file
from icreckon.replay.base.errors import ReplayError, os_errors

SQLITE_MAGIC = b"SQLite format 3\0"
STORAGE_SUFFIXES = (".mcap", ".db3")
PACKED_SUFFIX = ".zstd"
BAG_SUFFIXES = (".bag", *STORAGE_SUFFIXES, ".mcap.zstd", ".db3.zstd")
"""Ending of the name of a file that is compressed as a whole."""

T = TypeVar("T")


def _mcap_chunk(data: bytes, _: int, *, compression: str) -> bytes:
    return unpack(data, compression)


# The tables by which rosbags unpacks chunks. It compares the sizes of those of MCAP files afterwards.
storage_mcap.DECOMPRESSORS.update(
    {name: partial(_mcap_chunk, compression=name) for name in ("zstd", "lz4")}
)
rosbag1_reader.decompressors.update(
    {name: partial(unpack, compression=name) for name in ("bz2", "lz4")}
)


class _FolderReader(DirectoryReader):
    """Reader of ROS 2 folders that unpacks messages up to the limit."""

    _packed = False

    def open(self) -> None:
        """Open the folder, and leave the unpacking of its messages to `messages`."""
        super().open()
        self._packed = self.metadata.compression_mode == "message"
        self.metadata = self.metadata._replace(compression_mode=None)

    def messages(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        """Read messages, as `rosbag2.Reader.messages`."""
        for connection, time, data in super().messages(*args, **options):
            yield connection, time, unpack(data, "zstd") if self._packed else data


class Ros2Reader(rosbag2.Reader):
    """Reader of ROS 2 bags that unpacks up to the limit."""

    STORAGE_PLUGINS = MappingProxyType({**rosbag2.Reader.STORAGE_PLUGINS, "dir": _FolderReader})


class Bag(Protocol):
    """An open bag."""

    counts: dict[Channel, int]  # number of messages of each channel
    notes: list[str]  # findings for the user, such as a broken index

    def messages(self, topics: Collection[str]) -> Iterator[Record]:
        """Yield the messages of some topics, roughly in the order of recording."""


def over_bag(path: Path, work: Callable[[Bag], T]) -> T:
    """Run a function over a bag, or over its recoverable part if the index is broken.

    Args:
        path: a ROS 1 bag, a ROS 2 folder, or a bare `.mcap` or `.db3` file; also compressed as a whole
            (`.mcap.zstd`, `.db3.zstd`).
        work: function of the bag; it may be called again from the start, with the bag opened by
            another method.

    Returns:
        The result of `work`.

    Raises:
        ReplayError: no such file, no bag, nothing of it is readable, or it unpacks to more than the
            limit, see `unpacking.unpacked_limit`.
    """
    if not path.exists():
        raise ReplayError(f"{path}: no such file or folder")
    packed = _packed_files(path)
    if not packed:
        return _read(path, _ways(path, []), [], work)
    with TemporaryDirectory(prefix="icreckon-") as folder:
        try:
            unpacked, notes = _unpacked(packed, Path(folder))
            return _read(path, _ways(path, unpacked), notes, work)
        except ReplayError as problem:
            # The temporary place means nothing to a reader.
            shown = str(problem).replace(folder, str(packed[0].parent))
            raise ReplayError(shown) from problem


def _read(path: Path, ways: list[list[Path]], notes: list[str], work: Callable[[Bag], T]) -> T:
    """Run a function over a bag, opened by the first method that works."""
    reason = ""
    for files in ways:
        try:
            with _IndexedBag(files) as bag:
                bag.notes[:0] = notes
                if reason:
                    bag.notes.append(f"{path.name}: {reason}; its files were read one by one")
                return work(bag)
        except _UnreadableError as problem:
            reason = reason or str(problem)
    recovered = _RecoveredBag(path, ways[-1], reason)
    recovered.notes[:0] = notes
    return work(recovered)


class _UnreadableError(Exception):
    """rosbags cannot read the bag; the text is the reason."""


class _IndexedBag:
    """Bag with an intact index, read by rosbags."""

    def __init__(self, files: list[Path]) -> None:
        self.files = files
        self.counts: dict[Channel, int] = {}
        self.notes: list[str] = []
        self._stack = ExitStack()
        self._sources: list[tuple[Path, rosbag1.Reader | rosbag2.Reader, list[Connection]]] = []

    def __enter__(self) -> Self:
        try:
            for file in self.files:
                ros1 = file.is_file() and _magic(file) == ROS1_MAGIC
                reader = rosbag1.Reader(file) if ros1 else Ros2Reader(file)
                self._stack.enter_context(reader)
                self._sources.append((file, reader, list(reader.connections)))
                for connection in reader.connections:
                    channel = _channel(connection)
                    self.counts[channel] = self.counts.get(channel, 0) + connection.msgcount
        except ReplayError as problem:
            self._stack.close()
            raise ReplayError(f"{file}: {problem}") from None
        except Exception as problem:
            self._stack.close()
            raise _UnreadableError(_reason(problem)) from problem
        self.notes.extend(_unread_sqlite_journals(self.files))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def messages(self, topics: Collection[str]) -> Iterator[Record]:
        for file, reader, connections in self._sources:
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
                raise ReplayError(f"{file}: {problem}") from None
            except Exception as problem:
                raise _UnreadableError(_reason(problem)) from problem
            if found != listed:
                raise _UnreadableError(f"the index lists {listed} messages, {found} are there")


class _RecoveredBag:
    """Readable part of a bag whose index is missing or broken."""

    def __init__(self, path: Path, files: list[Path], reason: str) -> None:
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
    place = f"byte {walk.position} of {walk.path.stat().st_size}"
    if walk.damaged and count:
        number = f"{len(walk.damaged)} of its chunks {'are' if len(walk.damaged) > 1 else 'is'}"
        more = "" if walk.complete else f", and the file is cut short at {place}"
        found = (
            f"{number} damaged, the first at byte {walk.damaged[0]}{more}; {count} other messages "
            "were read"
        )
    elif walk.complete:
        found = f"all its {count} messages were read without the index"
    else:
        found = (
            f"the file is cut short or damaged at {place}, {count} messages before that were read"
        )
    return f"{walk.path.name}: {reason}; {found}"


def _packed_files(path: Path) -> list[Path]:
    """Files of a bag that are compressed as a whole, and were not unpacked."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ReplayError(f"{path}: is a device or a pipe; a log is a file or a folder")
    with os_errors(path, "cannot be read"):
        found = [path] if path.is_file() else sorted(path.iterdir())
    return [
        file
        for file in found
        if file.suffix == PACKED_SUFFIX
        and file.with_suffix("").suffix in STORAGE_SUFFIXES
        and not (path.is_dir() and file.with_suffix("").exists())
    ]


def _unpacked(packed: list[Path], folder: Path) -> tuple[list[Path], list[str]]:
    """Unpack files to a folder; return the new ones, and notes on damaged ones."""
    files, notes, rest = [], [], limit()
    for file in packed:
        target = folder / file.stem
        try:
            if not unpack_file(file, target, rest):
                notes.append(f"{file.name}: cut short or damaged; what could be unpacked was read")
        except ReplayError as problem:
            raise ReplayError(f"{file}: {problem}") from None
        except OSError as problem:
            raise ReplayError(
                f"{file}: cannot be unpacked to {folder.parent}: {problem.strerror}; TMPDIR names "
                "another place"
            ) from None
        rest -= target.stat().st_size
        files.append(target)
    return files, notes


def _ways(path: Path, unpacked: list[Path]) -> list[list[Path]]:
    """Methods of opening the bag, each a list of files to open together."""
    with os_errors(path, "cannot be read"):
        if path.is_file():
            files = unpacked or [path]
            _check_is_bag(files[0])
            return [files]
        files = sorted([*_storage_files(path), *unpacked], key=lambda file: file.name)
        if not files:
            raise ReplayError(f"{path}: {_why_no_bag(path)}")
        for file in files:
            _check_is_bag(file)
    # Of a bag that is compressed as a whole, rosbags would unpack all, without a limit.
    return [files] if any(path.glob(f"*{PACKED_SUFFIX}")) else [[path], files]


def _storage_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix in STORAGE_SUFFIXES)


def _why_no_bag(folder: Path) -> str:
    if any(folder.glob("*.bag")):
        return "a folder of ROS 1 bags; give its .bag files (replay: with --one-log if they are one log)"
    return "not a bag: the folder holds no .mcap, .db3 or .bag file (tables: name the files)"


def _check_is_bag(file: Path) -> None:
    magic = _magic(file)
    if not magic:
        raise ReplayError(f"{file}: the file is empty")
    if magic.startswith(b"#ROSBAG V") and magic != ROS1_MAGIC:
        raise ReplayError(f"{file}: only version 2.0 of ROS 1 bags is read; try `rosbag migrate`")
    known = (ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC[: len(ROS1_MAGIC)])
    if not magic.startswith(known):
        raise ReplayError(f"{file}: neither a bag (.bag, .mcap, .db3) nor a table (.csv, .parquet)")


def _magic(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(len(ROS1_MAGIC))


def _channel(connection: Connection) -> Channel:
    encoding = "ros1"
    if isinstance(connection.ext, ConnectionExtRosbag2):
        encoding = connection.ext.serialization_format
    return Channel(connection.topic, connection.msgtype, connection.msgdef, encoding)


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
