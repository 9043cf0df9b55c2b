"""Bag reader: channels and raw messages, recovered if the index is broken.

`over_bag` hides the difference. The content decides the format: ROS 1 bag, ROS 2 folder, bare MCAP
or SQLite file. Files that are compressed as a whole are unpacked first.
"""

from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from shutil import disk_usage
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, TypeVar

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.reader import DirectoryReader

from icreckon.replay.bags.records import LATEST, Channel, Record
from icreckon.replay.bags.recovery import MCAP_MAGIC, ROS1_MAGIC, RecordWalk
from icreckon.replay.bags.unpacking import unpack, unpack_file
from icreckon.replay.base.errors import ReplayError, os_errors

SQLITE_MAGIC = b"SQLite format 3\0"
STORAGE_SUFFIXES = (".mcap", ".db3")
PACKED_SUFFIX = ".zstd"  # ending of the name of a file that is compressed as a whole
BAG_SUFFIXES = (".bag", *STORAGE_SUFFIXES, ".mcap.zstd", ".db3.zstd")

T = TypeVar("T")


def _mcap_chunk(data: bytes, _: int, *, compression: str) -> bytes:
    """Decompress a chunk of an MCAP file; rosbags passes its unpacked size, too."""
    return unpack(data, compression)


# The tables by which rosbags unpacks chunks. It compares the sizes of those of MCAP files afterwards.
for _name in ("zstd", "lz4"):
    storage_mcap.DECOMPRESSORS[_name] = partial(_mcap_chunk, compression=_name)
for _name in ("bz2", "lz4"):
    rosbag1_reader.decompressors[_name] = partial(unpack, compression=_name)


class _FolderReader(DirectoryReader):
    """Reader of ROS 2 folders that unpacks messages up to the limit."""

    _has_packed_messages = False

    def open(self) -> None:
        """Open the folder, and leave the unpacking of its messages to `messages`."""
        super().open()
        self._has_packed_messages = self.metadata.compression_mode == "message"
        # So rosbags does not unpack them.
        self.metadata = self.metadata._replace(compression_mode=None)

    def messages(self, *args: Any, **options: Any) -> Generator[Any, None, None]:
        """Yield (connection, time of recording [ns], bytes), as `rosbag2.Reader.messages`."""
        for connection, time, data in super().messages(*args, **options):
            yield connection, time, unpack(data, "zstd") if self._has_packed_messages else data


class Ros2Reader(rosbag2.Reader):
    """Reader of ROS 2 bags that unpacks up to the limit."""

    STORAGE_PLUGINS = MappingProxyType({**rosbag2.Reader.STORAGE_PLUGINS, "dir": _FolderReader})


@dataclass
class Bag:
    """An open bag."""

    counts: Counter[Channel]  # number of messages of each channel
    notes: list[str]  # findings for the user, such as a broken index
    # function that yields the messages of some topics, roughly in the order of recording
    messages: Callable[[Collection[str]], Iterator[Record]]


def over_bag(path: Path, work: Callable[[Bag], T]) -> T:
    """Run a function over a bag, or over its recoverable part if the index is broken.

    The bag is a ROS 1 bag, a ROS 2 folder, or a bare `.mcap` or `.db3` file; also compressed as a whole
    (`.mcap.zstd`, `.db3.zstd`). `work` may be called again from the start, with the bag opened by another
    method.

    Raises:
        ReplayError: no such file, no bag, nothing of it is readable, or it unpacks to too much.
    """
    if not path.exists():
        raise ReplayError(f"{path}: no such file or folder")
    packed = _packed_files(path)
    if not packed:
        return _run_over(path, _file_sets(path, []), [], work)
    with TemporaryDirectory(prefix="icreckon-") as folder:
        try:
            unpacked, notes = _unpack_files(packed, Path(folder))
            return _run_over(path, _file_sets(path, unpacked), notes, work)
        except ReplayError as problem:
            # The user knows the packed file, not its temporary copy.
            text = str(problem).replace(folder, str(packed[0].parent))
            raise ReplayError(text) from problem


def _run_over(path: Path, sets: list[list[Path]], notes: list[str], work: Callable[[Bag], T]) -> T:
    """Run a function over a bag, by the first set of files that rosbags can read."""
    # rosbags may fail only while `work` reads messages: `work` is called again, with the next set. If all
    # sets fail, the last one is recovered record by record. `notes` come before those of the bag.
    reason = ""
    for files in sets:
        try:
            with _indexed_bag(files) as bag:
                bag.notes[:0] = notes
                # A folder of bag files needs no metadata.
                if reason and (path.is_file() or (path / "metadata.yaml").exists()):
                    bag.notes.append(f"{path.name}: {reason}; its files were read one by one")
                return work(bag)
        except _UnreadableError as problem:
            reason = reason or str(problem)
    recovered = _recovered_bag(path, sets[-1], reason)
    recovered.notes[:0] = notes
    return work(recovered)


class _UnreadableError(Exception):
    """rosbags cannot read the bag; the text is the reason."""


@contextmanager
def _read_by_rosbags(file: Path) -> Iterator[None]:
    """Turn errors of rosbags into _UnreadableError; name a file too large to unpack."""
    try:
        yield
    except ReplayError as problem:
        raise ReplayError(f"{file}: {problem}") from None
    except Exception as problem:
        # One line of text, with the type unless it is a reader's error.
        text = " ".join(str(problem).split()).rstrip(".")
        if not isinstance(problem, (rosbag1.ReaderError, rosbag2.ReaderError)) or not text:
            text = f"{type(problem).__name__}: {text}" if text else type(problem).__name__
        raise _UnreadableError(text) from problem


@contextmanager
def _indexed_bag(files: list[Path]) -> Iterator[Bag]:
    """Open a bag with an intact index, which rosbags reads."""
    readers: list[tuple[Path, rosbag1.Reader | rosbag2.Reader]] = []
    counts: Counter[Channel] = Counter()

    def messages(topics: Collection[str]) -> Iterator[Record]:
        for file, reader in readers:
            wanted = [connection for connection in reader.connections if connection.topic in topics]
            if not wanted:
                continue
            channels = {connection.id: _channel(connection) for connection in wanted}
            listed, read = sum(connection.msgcount for connection in wanted), 0
            with _read_by_rosbags(file):
                for connection, time, data in reader.messages(wanted):
                    if not 0 <= time < LATEST:
                        break  # damaged: the counts will differ
                    read += 1
                    yield Record(channels[connection.id], time, data)
            if read != listed:
                raise _UnreadableError(f"the index lists {listed} messages, {read} are there")

    with ExitStack() as stack:
        for file in files:
            with _read_by_rosbags(file):
                is_ros1 = file.is_file() and _first_bytes(file) == ROS1_MAGIC
                reader = rosbag1.Reader(file) if is_ros1 else Ros2Reader(file)
                stack.enter_context(reader)
                readers.append((file, reader))
                for connection in reader.connections:
                    counts[_channel(connection)] += connection.msgcount
        yield Bag(counts, _journal_notes(files), messages)


def _recovered_bag(path: Path, files: list[Path], reason: str) -> Bag:
    """Open the readable part of a bag whose index is missing or broken."""
    counts: Counter[Channel] = Counter()
    notes, walks = [], list(map(RecordWalk, files))
    for walk in walks:
        first_bytes = _first_bytes(walk.path)
        # A file that was cut short may have less than the whole magic.
        if first_bytes and SQLITE_MAGIC.startswith(first_bytes):
            raise ReplayError(
                f"{walk.path}: the SQLite file cannot be read ({reason}); "
                "`sqlite3 broken.db3 .recover | sqlite3 saved.db3` may save what is left"
            )
        with os_errors(walk.path, "cannot be read"):
            try:
                found = Counter(record.channel for record in walk.records())
            except ReplayError as problem:
                raise ReplayError(f"{walk.path}: {problem}") from None
        counts.update(found)
        # Channels without messages, too.
        counts.update(dict.fromkeys(walk.channels.values(), 0))
        notes.append(_recovery_note(walk, found.total(), reason))
    if not any(counts.values()):
        raise ReplayError(f"{path}: no message can be read ({reason})")

    def messages(topics: Collection[str]) -> Iterator[Record]:
        records = chain.from_iterable(walk.records() for walk in walks)
        return (record for record in records if record.channel.topic in topics)

    return Bag(counts, notes, messages)


def _recovery_note(walk: RecordWalk, count: int, reason: str) -> str:
    """Note on a recovered file: reason, damage, number of messages that were read."""
    place = f"byte {walk.position} of {walk.path.stat().st_size}"
    if walk.damaged and count:
        chunks_are = f"{len(walk.damaged)} of its chunks {'are' if len(walk.damaged) > 1 else 'is'}"
        cut = "" if walk.complete else f", and the file is cut short at {place}"
        others = f"{count} other messages were read"
        outcome = f"{chunks_are} damaged, the first at byte {walk.damaged[0]}{cut}; {others}"
    elif walk.complete:
        outcome = f"all its {count} messages were read without the index"
    else:
        number = f"{count} messages before that were read"
        outcome = f"the file is cut short or damaged at {place}, {number}"
    return f"{walk.path.name}: {reason}; {outcome}"


def _packed_files(path: Path) -> list[Path]:
    """Files compressed as a whole that have no unpacked file next to them."""
    if not (path.is_file() or path.is_dir()):
        raise ReplayError(f"{path}: is a device or a pipe; a log is a file or a folder")
    with os_errors(path, "cannot be read"):
        candidates = [path] if path.is_file() else sorted(path.iterdir())
    return [
        file
        for file in candidates
        if file.suffix == PACKED_SUFFIX
        and file.with_suffix("").suffix in STORAGE_SUFFIXES
        and not (path.is_dir() and file.with_suffix("").exists())
    ]


def _unpack_files(packed: list[Path], folder: Path) -> tuple[list[Path], list[str]]:
    """Unpack files to a folder; return the new files, and notes on damaged ones."""
    # All of them together leave half of the disk that is free.
    files, notes, bytes_left = [], [], disk_usage(folder).free // 2
    for file in packed:
        target = folder / file.stem
        try:
            if not unpack_file(file, target, bytes_left):
                notes.append(f"{file.name}: cut short or damaged; what could be unpacked was read")
        except (ReplayError, OSError) as problem:
            reason = f"{problem}, half of what is free"
            if isinstance(problem, OSError):
                reason = str(problem.strerror)
            raise ReplayError(
                f"{file}: cannot be unpacked to {folder.parent}: {reason}; TMPDIR names another place"
            ) from None
        bytes_left -= target.stat().st_size
        files.append(target)
    return files, notes


def _file_sets(path: Path, unpacked: list[Path]) -> list[list[Path]]:
    """Sets of files by which a bag can be opened, in the order of trial."""
    # For a ROS 2 folder: the folder itself, by its metadata, then its storage files without metadata.
    # `unpacked` are storage files that were unpacked elsewhere.
    with os_errors(path, "cannot be read"):
        if path.is_file():
            files = unpacked or [path]
            _check_is_bag(files[0])
            return [files]
        files = sorted([*_storage_files(path), *unpacked], key=lambda file: file.name)
        if not files and any(path.glob("*.bag")):
            raise ReplayError(
                f"{path}: a folder of ROS 1 bags; give its .bag files (replay: with --one-log if they "
                "are one log)"
            )
        if not files:
            bags = ", ".join(sorted(one.parent.name for one in path.glob("*/metadata.yaml")))
            several = f"; there are bags in it, to be given one by one: {bags}" if bags else ""
            raise ReplayError(
                f"{path}: not a log: the folder holds no .mcap, .db3 or .bag file and no table{several}"
            )
        for file in files:
            _check_is_bag(file)
    # Given such a folder, rosbags would unpack its compressed files, without a limit.
    return [files] if any(path.glob(f"*{PACKED_SUFFIX}")) else [[path], files]


def _storage_files(folder: Path) -> list[Path]:
    """MCAP and SQLite files of a ROS 2 folder, not compressed as a whole."""
    return sorted(file for file in folder.iterdir() if file.suffix in STORAGE_SUFFIXES)


def _check_is_bag(file: Path) -> None:
    """Raise a ReplayError for a file that is empty or not a bag by its first bytes."""
    first_bytes = _first_bytes(file)
    if not first_bytes:
        raise ReplayError(f"{file}: the file is empty")
    if first_bytes.startswith(b"#ROSBAG V") and first_bytes != ROS1_MAGIC:
        raise ReplayError(f"{file}: only version 2.0 of ROS 1 bags is read; try `rosbag migrate`")
    # SQLite's magic is longer than the bytes that were read.
    known = (ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC[: len(ROS1_MAGIC)])
    if not first_bytes.startswith(known):
        raise ReplayError(f"{file}: neither a bag (.bag, .mcap, .db3) nor a table (.csv, .parquet)")


def _first_bytes(file: Path) -> bytes:
    """First 13 bytes of a file, by which all formats differ; fewer if it is shorter."""
    with file.open("rb") as stream:
        return stream.read(len(ROS1_MAGIC))


def _channel(connection: Connection) -> Channel:
    """Channel of a connection of rosbags; only ROS 2 bags name their encoding."""
    encoding = "ros1"
    if isinstance(connection.ext, ConnectionExtRosbag2):
        encoding = connection.ext.serialization_format
    return Channel(connection.topic, connection.msgtype, connection.msgdef, encoding)


def _journal_notes(files: list[Path]) -> list[str]:
    """Notes on SQLite journals (`.db3-wal`) with messages that their databases lack."""
    notes = []
    for file in files:
        for database in _storage_files(file) if file.is_dir() else [file]:
            journal = database.with_name(f"{database.name}-wal")
            if database.suffix == ".db3" and journal.is_file() and journal.stat().st_size:
                notes.append(
                    f"{journal.name}: holds messages that were never merged into {database.name} and "
                    f"were not read; `sqlite3 {database.name} 'PRAGMA wal_checkpoint'` merges them"
                )
    return notes
