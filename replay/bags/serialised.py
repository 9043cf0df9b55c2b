"""Serialisation of many messages that differ in their numbers only.

One message of placeholders is serialised and shows at which bytes each number is. The numbers of all
others are filled in there as columns.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Stamps
from icreckon.replay.bags.decoding import NANOSECONDS
from icreckon.replay.bags.messages import Messages

BLOCK = 1024  # messages that are in memory at once
NUMBER_BYTES = 8  # bytes of a float64, and of a stamp of seconds and nanoseconds
PLACEHOLDER_STAMP = 1_234_567_890_987_654_321


def serialised_alike(
    messages: Messages,
    msgtype: str,
    make: Callable[..., Any],
    stamps: Stamps,
    columns: Sequence[NDArray[Any]],
) -> Iterator[bytes]:
    """Yield messages as bytes.

    Args:
        messages: factory and serialiser.
        msgtype: type of the messages.
        make: function that makes a message from `messages`, a stamp [ns] and a row of each column; the
            message must hold the numbers of the rows unchanged, as float64.
        stamps: (n,) stamps [ns].
        columns: arrays (n, ...) of numbers.

    Raises:
        ValueError: the message of `make` lacks a number, or holds it in another form.
    """
    rng = np.random.default_rng(0)
    placeholders = [rng.uniform(1.0, 2.0, (1, *column.shape[1:])) for column in columns]
    message = make(messages, PLACEHOLDER_STAMP, *(row for (row,) in placeholders))
    template = np.frombuffer(bytes(messages.serialize(message, msgtype)), np.uint8)
    (patterns,) = _rows(np.array([PLACEHOLDER_STAMP]), placeholders)
    places = _places(template.tobytes(), patterns)
    if len({number for number, _ in places}) < len(patterns):
        raise ValueError(f"a {msgtype} does not hold all of its numbers unchanged")
    for first in range(0, len(stamps), BLOCK):
        block = slice(first, first + BLOCK)
        rows = _rows(stamps[block], [column[block] for column in columns])
        data = np.tile(template, (len(rows), 1))
        for number, place in places:
            data[:, place : place + NUMBER_BYTES] = rows[:, number]
        yield from map(bytes, data)


def _rows(stamps: Stamps, columns: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
    """Bytes (n, k, 8) of the stamp and the numbers of each message."""
    parts = [np.column_stack(np.divmod(stamps, NANOSECONDS)).astype("<u4")]
    parts += [column.reshape(len(column), -1).astype("<f8", order="C") for column in columns]
    numbers = np.hstack([part.view(np.uint8) for part in parts])
    return numbers.reshape(len(numbers), -1, NUMBER_BYTES)


def _places(data: bytes, patterns: NDArray[np.uint8]) -> list[tuple[int, int]]:
    """Pairs of a number of a row and a place of its bytes in a message."""
    places = []
    for number, pattern in enumerate(patterns):
        place = data.find(pattern.tobytes())
        while place >= 0:
            places.append((number, place))
            place = data.find(pattern.tobytes(), place + NUMBER_BYTES)
    return places
