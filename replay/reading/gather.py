"""Gathering of the streams of a mapping from bags and tables that make one log."""

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from icreckon.replay.bags.bag_files import BAG_SUFFIXES, Bag, over_bag
from icreckon.replay.bags.decoding import Definitions, decoder
from icreckon.replay.bags.message_types import IMU, JOINT_STATE, NAVSATFIX, STRING
from icreckon.replay.bags.table_files import TABLE_SUFFIXES, is_table, is_trajectory
from icreckon.replay.base.errors import (
    OF_LEFT_OUT,
    OF_ROBOT_FILE,
    NoRowsError,
    ReplayError,
    os_errors,
)
from icreckon.replay.mapping.field_paths import field_reader
from icreckon.replay.mapping.naming import is_truth
from icreckon.replay.mapping.topics import MAPPING_TOPIC, FixTopic, TopicMap, TrackTopic, TruthTopic
from icreckon.replay.reading import message_rows
from icreckon.replay.reading.conversions import imu_readers, pose_rows
from icreckon.replay.reading.stream import Stream, TopicReader
from icreckon.replay.reading.tables import Table, table_streams, wanted_columns
from icreckon.replay.reading.tf import TransformStream

LOG_SUFFIXES = (*BAG_SUFFIXES, *TABLE_SUFFIXES)
PROGRESS_EVERY = 2000  # messages between two reports of progress

Progress = Callable[[float], None]


@dataclass
class Gathered:
    """Streams gathered from some files."""

    source: str  # name of the files, for messages
    mapping: TopicMap  # the mapping that was used
    streams: dict[str, Stream] = field(default_factory=dict)  # the available streams, by purpose
    found: Counter[str] = field(default_factory=Counter)  # topics with their types, or columns
    notes: list[str] = field(default_factory=list)  # findings about the files, for the user
    truth_source: str | None = None  # name of the truth's reference system in the files, or None

    def add(self, of_file: "Gathered") -> None:
        """Add what one more file holds; streams of the same purpose become one."""
        self.notes += of_file.notes
        self.truth_source = self.truth_source or of_file.truth_source
        self.found.update(of_file.found)
        for purpose, stream in of_file.streams.items():
            known = self.streams.get(purpose)
            # A table with all columns is used alone; others like it, that lack some, are joined.
            if known is None or (known.missing and not stream.missing):
                self.streams[purpose] = stream
            elif known.missing or known.joins or not stream.missing:
                known.extend(stream)


def as_paths(path: Path | str | Sequence[Path | str]) -> list[Path]:
    """Convert one or several paths, which make one log, to a list.

    A folder with a table stands for the bags and tables in it.

    Raises:
        ReplayError: there is no path, one is not UTF-8, or one is given twice.
    """
    paths = [Path(path)] if isinstance(path, Path | str) else list(map(Path, path))
    if not paths:
        raise ReplayError("no log: give at least one file")
    for name in map(str, paths):
        if name != name.encode("utf-8", "replace").decode():
            raise ReplayError(f"{name!a}: the name is not UTF-8; rename the file")
    paths = [file for named in paths for file in _parts_of(named) or [named]]
    refuse_twice(paths, "log")
    return paths


def first_path(path: Path | str | Sequence[Path | str]) -> Path:
    """First file or folder that was named, after which the log is named."""
    return Path(path if isinstance(path, Path | str) else path[0])


def log_files(folder: Path) -> list[Path]:
    """Bags and tables in a folder, by name; none if it is no folder, or a ROS 2 bag."""
    if not folder.is_dir() or (folder / "metadata.yaml").exists():
        return []
    with os_errors(folder, "cannot be read"):
        files = sorted(folder.iterdir(), key=lambda file: file.name)
    found = [file for file in files if file.name.lower().endswith(LOG_SUFFIXES)]
    if any(file.name.lower().endswith(BAG_SUFFIXES) for file in found):
        return found
    # With tables, the trajectory of a truth. Other texts are notes, or estimates.
    texts = (file for file in files if is_truth(file.stem) and is_table(file))
    return sorted({*found, *filter(is_trajectory, texts)})


def _parts_of(folder: Path) -> list[Path]:
    """Files of a folder with a table; none for bags alone, which `over_bag` opens."""
    files = log_files(folder)
    has_table = any(not file.name.lower().endswith(BAG_SUFFIXES) for file in files)
    return files if has_table else []


def refuse_twice(names: Sequence[Path | str], what: str) -> None:
    """Raise a ReplayError if a list of files names one twice, also by links."""
    seen = set()
    for name in names:
        place = os.path.realpath(name)
        if place in seen:
            raise ReplayError(f"{what} {name} is given twice; leave one of them out")
        seen.add(place)


def source_name(paths: Sequence[Path]) -> str:
    """Name of files in messages: the first, and the number of the others."""
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return f"{paths[0]}{more}"


def gather(
    paths: Sequence[Path],
    mapping: TopicMap,
    *,
    own_mapping: bool = True,
    definitions: Definitions = (),
    progress: Progress | None = None,
) -> Gathered:
    """Read the streams of a mapping from the files of one log.

    A bag's own mapping replaces `mapping` unless `own_mapping` is False; `progress` is called with the
    share of the files that is read, from 0 to 1.

    Raises:
        ReplayError: no bag or table, no track speeds although mapped, or an unsupported message type.
    """
    result = Gathered(source_name(paths), mapping)
    bags = [path for path in paths if path.is_dir() or not is_table(path)]
    if own_mapping:
        _use_own_mapping(result, bags, definitions)

    def report(number: int, share: float) -> None:
        if progress is not None:
            progress((number + share) / len(paths))

    read_bag = partial(_of_bag, mapping=result.mapping, definitions=definitions)
    for number, path in enumerate(paths):
        if path in bags:
            read = partial(read_bag, path=path, report=partial(report, number))
            result.add(over_bag(path, read))
            continue
        try:
            result.add(_of_table(path, result.mapping))
        except NoRowsError as problem:
            if len(paths) == 1:
                raise
            result.notes.append(f"{problem}: not used")
    result.streams = {key: stream for key, stream in result.streams.items() if not stream.missing}
    _check_all_there(result, bags, paths)
    if bags:
        result.notes += _left_out(result)
    return result


def _use_own_mapping(result: Gathered, bags: Sequence[Path], definitions: Definitions) -> None:
    """Replace the robot file's mapping by that of a bag, if a bag holds one."""
    for path in bags:
        read = partial(_first_text, path=path, topic=MAPPING_TOPIC, definitions=definitions)
        text, notes = over_bag(path, read)
        result.notes += notes
        if text is None:
            continue
        try:
            result.mapping = msgspec.json.decode(text, type=TopicMap)
        except msgspec.DecodeError as problem:
            result.notes.append(f"topic {MAPPING_TOPIC!r} cannot be read: {problem}")
        else:
            result.notes.append(
                f"topics as the bag itself names them ({MAPPING_TOPIC}), not as the robot file does"
            )
            return


def _first_text(
    bag: Bag, path: Path, topic: str, definitions: Definitions
) -> tuple[str | None, list[str]]:
    """First readable text on a topic, None without any; notes on unreadable texts."""
    notes: list[str] = []
    if all(channel.topic != topic for channel in bag.counts):
        return None, notes
    for record in bag.messages([topic]):
        if record.channel.msgtype != STRING:
            break
        try:
            decode = decoder(record.channel, str(path), definitions)
            return str(decode(record.data).data), notes
        except Exception as problem:
            notes.append(f"topic {topic!r} cannot be read: {problem}")
    return None, notes


def _of_table(path: Path, mapping: TopicMap) -> Gathered:
    table = Table(path)
    if mapping.columns is None:
        names = ", ".join(column.name for column in table.columns)
        raise ReplayError(
            f"{path}: a table needs [log.columns] in the robot file (`icreckon inspect {path}` "
            f"proposes it); its columns are {names}"
        )
    streams = {stream.purpose: stream for stream in table_streams(table, mapping.columns)}
    found = Counter({f"{path.name}: {column.name}": len(table) for column in table.columns})
    return Gathered(str(path), mapping, streams, found, list(table.notes))


def _of_bag(
    bag: Bag, path: Path, mapping: TopicMap, definitions: Definitions, report: Progress
) -> Gathered:
    of_file = Gathered(str(path), mapping)
    messages: Counter[str] = Counter()
    for channel, count in bag.counts.items():
        messages[channel.topic] += count
        of_file.found[f"{channel.topic} ({channel.msgtype})"] += count
    types = {channel.topic: channel.msgtype for channel in bag.counts}
    by_topic: dict[str, list[Stream]] = {}
    for stream in wanted_streams(mapping, str(path), definitions, types):
        if not all(messages[topic] for topic, is_needed in stream.topics.items() if is_needed):
            continue
        of_file.streams[stream.purpose] = stream
        for topic in stream.topics:
            by_topic.setdefault(topic, []).append(stream)
    total = sum(messages[topic] for topic in by_topic)
    for count, record in enumerate(bag.messages(by_topic), start=1):
        if count % PROGRESS_EVERY == 0:
            report(min(1.0, count / total))
        for stream in by_topic[record.channel.topic]:
            stream.take(record)
    if mapping.truth is not None and mapping.truth.source_topic and "truth" in of_file.streams:
        topic = mapping.truth.source_topic
        of_file.truth_source, notes = _first_text(bag, path, topic, definitions)
        of_file.notes += notes
    of_file.notes[:0] = bag.notes
    return of_file


def wanted_streams(
    mapping: TopicMap, source: str, definitions: Definitions, types: dict[str, str]
) -> Iterator[Stream]:
    """Yield the streams of a mapping, still empty."""
    shared: dict[str, Any] = {"source": source, "definitions": definitions}

    def stream(purpose: str, topic: str, mapped: Any, *readers: Any) -> Stream:
        return Stream(purpose, topic, *readers, time=mapped.time, **shared)

    def pose_stream(purpose: str, mapped: FixTopic | TruthTopic) -> Stream:
        if mapped.frames is not None:
            of_frames = partial(TransformStream, time=mapped.time, frames=mapped.frames)
            return of_frames(purpose, mapped.topic, **shared)
        if isinstance(mapped, FixTopic) and mapped.names:
            by_field = field_reader(mapped.names, partial(pose_rows, mapped))
            return stream(purpose, mapped.topic, mapped, {}, by_field)
        readers = message_rows.POSE_READERS | message_rows.GEODETIC_READERS
        return stream(purpose, mapped.topic, mapped, readers)

    def track_stream(tracks: TrackTopic) -> Stream:
        left, right = tracks.names[: len(tracks.left)], tracks.names[len(tracks.left) :]
        are_counters = tracks.are_counters
        if tracks.right_topic:
            left_readers = message_rows.side_readers(left, 0, len(right), are_counters)
            right_readers = message_rows.side_readers(right, len(left), 0, are_counters)
            both = stream("tracks", tracks.topic, tracks, *left_readers)
            both.second = TopicReader("tracks", tracks.right_topic, *right_readers)
            return both
        readers = message_rows.track_readers(tracks.names, are_counters)
        by_field = tracks.names and types.get(tracks.topic) not in readers
        reader = field_reader(tracks.names) if by_field else None
        return stream("tracks", tracks.topic, tracks, readers, reader)

    if tracks := mapping.tracks:
        yield track_stream(tracks)
    if imu := mapping.imu:
        readers, of_forces = imu_readers(imu)
        of_imu = stream("imu", imu.topic, imu, *readers)
        if imu.acceleration_topic is not None:
            of_imu.second = TopicReader("imu", imu.acceleration_topic, *of_forces)
        yield of_imu
    if fixes := mapping.fixes:
        yield pose_stream("fixes", fixes)
    if heading := mapping.heading:
        yield stream("heading", heading.topic, heading, message_rows.HEADING_READERS)
    if velocity := mapping.velocity:
        yield stream("velocity", velocity.topic, velocity, message_rows.VELOCITY_READERS)
    if truth := mapping.truth:
        yield pose_stream("truth", truth)
        if truth.twist:
            yield stream("truth twist", truth.twist, truth, message_rows.TWIST_READERS)
        if truth.tracks and tracks:
            reader = message_rows.JointReader(tracks.names, False)  # of velocities
            yield stream("truth tracks", truth.tracks, truth, {JOINT_STATE: reader})


def _check_all_there(result: Gathered, bags: Sequence[Path], paths: Sequence[Path]) -> None:
    """Note mapped streams that the files lack; ReplayError if they lack track speeds."""
    available = ", ".join(sorted(result.found)) or "none at all"
    missing: dict[str, list[str]] = {}
    if bags:
        for stream in wanted_streams(result.mapping, result.source, (), {}):
            if stream.purpose.startswith("truth ") and missing["truth"]:
                continue  # a truth without poses is noted once, not for its twists and tracks
            texts = missing.setdefault(stream.purpose, [])
            for topic in (topic for topic, is_needed in stream.topics.items() if is_needed):
                found = result.found.items()
                counts = [count for name, count in found if name.split(" (")[0] == topic]
                if not sum(counts):
                    lack = "has no messages" if counts else "is not in the bag"
                    texts.append(f"topic {topic!r} for {stream.purpose} {lack}")
    if len(bags) < len(paths) and result.mapping.columns is not None:
        for purpose, spec in wanted_columns(result.mapping.columns):
            listed_names = [spec.time or result.mapping.columns.time, *spec.names]
            missing.setdefault(purpose, []).append(
                f"columns {', '.join(listed_names)} for {purpose} are not all in these tables"
            )
    for purpose, texts in missing.items():
        if purpose in result.streams:
            continue
        if purpose == "tracks":
            remedy = "Name the right one in the robot file's [log.tracks]"
            if not bags:
                remedy = "Correct the robot file's [log.columns.tracks]"
            raise ReplayError(
                f"{result.source}: {' and '.join(texts)}; there is {available}. {remedy}, or leave that "
                "table out"
            )
        result.notes.append(f"{OF_ROBOT_FILE}{' and '.join(texts)}; there is {available}")


def _left_out(result: Gathered) -> Iterator[str]:
    """Note an IMU that the robot file leaves out, and a receiver if it has no truth."""
    mapping = result.mapping
    uses = {IMU: ("an IMU", "imu")} if mapping.imu is None else {}
    if mapping.fixes is None and mapping.truth is None:
        uses[NAVSATFIX] = "position fixes", "fixes"
    for name in sorted(result.found):
        topic, _, msgtype = name.removesuffix(")").partition(" (")
        if msgtype in uses and result.found[name]:
            use, purpose = uses[msgtype]
            yield (
                f"{OF_LEFT_OUT}{use} on {topic}, which the file leaves out: "
                f'topic = "{topic}" in [log.{purpose}], see icreckon inspect'
            )
