"""SQLite bags whose columns hold values of other types than they should."""

import sqlite3
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from bag_messages import JOINTS, SPEEDS, STORE, robot_with
from icreckon.replay.base.errors import ReplayError
from icreckon.replay.inspection.inspect import inspect
from icreckon.replay.reading.read_log import read_log


def changed(folder: Path, change: str) -> Path:
    """A bare .db3 file with a change."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        kind = SPEEDS[0][1].__msgtype__
        at = writer.add_connection("/js", kind, typestore=STORE)
        for _, message in SPEEDS:
            writer.write(at, message.header.stamp.sec * 10**9, STORE.serialize_cdr(message, kind))
    file = next(folder.glob("*.db3"))
    database = sqlite3.connect(file)
    database.execute("PRAGMA writable_schema = 1")
    database.execute("UPDATE sqlite_master SET sql = replace(sql, 'NOT NULL', '')")
    database.commit()
    database.close()
    database = sqlite3.connect(file)
    database.execute(change)
    database.commit()
    database.close()
    return file


@pytest.mark.parametrize("value", ["NULL", "x'ff00'"])
@pytest.mark.parametrize("column", ["name", "type", "serialization_format"])
def test_names_that_are_no_text_are_refused(tmp_path: Path, column: str, value: str) -> None:
    file = changed(tmp_path / "bag", f"UPDATE topics SET {column} = {value}")  # noqa: S608
    for read in (inspect, lambda path: read_log(path, robot_with(tracks=JOINTS))):
        with pytest.raises(ReplayError, match="the name or type of a topic is no text"):
            read(file)


@pytest.mark.parametrize("value", ["NULL", "'x'", "-9223372036854775807"])
def test_times_that_are_none_are_refused(tmp_path: Path, value: str) -> None:
    change = f"UPDATE messages SET timestamp = {value} WHERE id = 2"  # noqa: S608
    file = changed(tmp_path / "bag", change)
    for read in (inspect, lambda path: read_log(path, robot_with(tracks=JOINTS))):
        with pytest.raises(ReplayError, match="SQLite file cannot be read"):
            read(file)


def test_messages_and_definitions_that_are_null(tmp_path: Path) -> None:
    file = changed(tmp_path / "bag", "UPDATE messages SET data = NULL WHERE id = 2")
    assert read_log(file, robot_with(tracks=JOINTS)).dropped == {"tracks: cannot be decoded": 1}
    change = "UPDATE message_definitions SET encoded_message_definition = NULL"
    file = changed(tmp_path / "other", change)
    assert len(read_log(file, robot_with(tracks=JOINTS)).tracks.stamps) == 3
