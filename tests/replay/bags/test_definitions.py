"""Definitions of message types that are small and make large messages."""

import time
from pathlib import Path

import pytest
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from command_line import fails
from icreckon.replay.bags.decoding import DEEPEST, MOST_FIELDS, decoder, read_definitions
from icreckon.replay.bags.records import Channel
from icreckon.replay.base.errors import ReplayError

NEXT = "\n" + "=" * 80 + "\nMSG: "
VECTOR = f"{NEXT}geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"


def chain(length: int, fields: str) -> list[str]:
    """Types of which each holds the next."""
    parts = [f"{NEXT}a/T{k}\n{fields.format(next=f'a/T{k + 1}')}\n" for k in range(length)]
    return [*parts, f"{NEXT}a/T{length}\nfloat64 x\n"]


HOSTILE = {
    "an array of structs": f"geometry_msgs/Vector3[1000000000] v{VECTOR}",
    "an array of texts": "string[1000000000] v\n",
    "each holds two of the next": "a/T0 a\n" + "".join(chain(40, "{next} a\n{next} b")),
    "each holds a thousand": "a/T0 a\n" + "".join(chain(10, "{next}[1000] a")),
    "deep": "a/T0 a\n" + "".join(chain(3000, "{next} a")),
    "deep, the last one first": "a/T0 a\n" + "".join(reversed(chain(3000, "{next} a"))),
    "of itself": "a/M a\n",
    "of sequences of itself": "a/M[] a\n",
    "very long": "float64 x\n" + "# " + "x" * 600_000,
}


def channel(text: str) -> Channel:
    return Channel("/t", "a/msg/M", MessageDefinition(MessageDefinitionFormat.MSG, text), "cdr")


@pytest.mark.parametrize("name", HOSTILE)
def test_a_definition_beyond_the_limits_is_refused(name: str) -> None:
    began = time.process_time()
    with pytest.raises(
        ReplayError, match=r"definition cannot be read: .*(fields|types|characters)"
    ) as e:
        decoder(channel(HOSTILE[name]), "bag")
    # Of the hours that each would take.
    assert time.process_time() - began < 60.0
    assert len(str(e.value)) < 300


def test_definitions_within_the_limits_are_decoded() -> None:
    count = MOST_FIELDS // 3
    text = f"geometry_msgs/Vector3[{count}] v{VECTOR}"
    message = decoder(channel(text), "bag")(b"\0\1\0\0" + b"\0" * (24 * count))
    assert len(message.v) == count
    deep = "a/T0 a\n" + "".join(chain(DEEPEST - 2, "{next} a"))
    assert decoder(channel(deep), "bag")(b"\0\1\0\0" + b"\0" * 8) is not None


def test_a_long_error_is_shortened(tmp_path: Path) -> None:
    with pytest.raises(ReplayError) as caught:
        decoder(channel("float64 x\n" * 1000 + "§"), "bag")
    assert len(str(caught.value)) < 400
    file = tmp_path / "our_msgs" / "msg" / "Wide.msg"
    file.parent.mkdir(parents=True)
    file.write_text("string[1000000000] x\n", encoding="utf-8")
    with pytest.raises(ReplayError, match="has 1000000000 fields, at most 10000 are read"):
        read_definitions([file])
    file.write_text("§" * 10_000, encoding="utf-8")
    assert len(fails("inspect", file, "--msg", file, cwd=tmp_path)) < 500
