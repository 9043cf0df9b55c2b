"""Damaged copies of a file: bits flipped, bytes cut off, doubled, taken out, put in, overwritten."""

from collections.abc import Iterator

import numpy as np

LONGEST = 40
"""Most bytes that are taken out, doubled, put in or overwritten at once."""


def mutated(data: bytes, seed: int, count: int) -> Iterator[bytes]:
    """Yield damaged copies; the same for the same seed."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        hurt = data
        for _ in range(rng.integers(1, 4)):
            hurt = _once(hurt, rng)
        yield hurt


def _once(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(0, len(data) + 1))
    length = int(rng.integers(1, LONGEST))
    match rng.integers(0, 7):
        case 0:
            changed = bytearray(data)
            for place in rng.integers(0, len(data), rng.integers(1, 6)) if data else ():
                changed[place] ^= 1 << rng.integers(0, 8)
            return bytes(changed)
        case 1:
            return data[:at]
        case 2:
            return data[:at] + data[at : at + length] + data[at:]
        case 3:
            return data[:at] + data[at + length :]
        case 4:
            return data[:at] + rng.bytes(length) + data[at:]
        case 5:
            return data[:at] + bytes([rng.choice([0, 0x7F, 0x80, 0xFF])] * 8) + data[at + 8 :]
        case _:
            # Digits and signs, for texts.
            return data[:at] + rng.choice([b"-", b"9", b"e", b"nan", b'"', b"\n", b","]) + data[at:]
