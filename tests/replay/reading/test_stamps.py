"""Stamps that are wrong, and clocks that were set: see `icreckon.replay.reading.stamps`."""

import numpy as np
import pytest

from icreckon.replay.reading.stamps import doubled_times

SECOND = 1_000_000_000


def test_a_wrong_stamp_long_before_a_short_log_doubles_no_time() -> None:
    """The empty windows behind it halved the usual count: most of the log was left out."""
    stamps = np.arange(0, 40 * SECOND, SECOND // 100)
    wrong = np.sort(np.append(stamps, -60 * SECOND))
    assert doubled_times(wrong) == doubled_times(stamps) == []
    twice = np.sort(np.concatenate([wrong, stamps[1000:2000] + 1]))
    ((begin, end),) = doubled_times(twice)
    assert (begin, end) == pytest.approx((10 * SECOND, 20 * SECOND), abs=SECOND)
