"""Readers of rosbags that unpack up to the limit, see `unpacking`."""

from __future__ import annotations

from collections.abc import Generator
from functools import partial
from types import MappingProxyType
from typing import Any

from rosbags import rosbag2
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.reader import DirectoryReader

from icreckon.replay.bags.unpacking import unpack


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
