"""Several files as one log: parts of one recording are joined, two recordings are refused."""

from dataclasses import replace
from pathlib import Path

import pytest

from conftest import make_log
from icreckon import Log, ReplayError, load_robot, read_log, write_log
from icreckon.replay.comparison.fixes import parse_part, with_fixes_within

SECOND = 1_000_000_000


def written(log: Log, path: Path) -> Path:
    return write_log(log, path, "mcap", load_robot("marmotte"))


def test_parts_are_joined_in_any_order(tmp_path: Path) -> None:
    robot, log = load_robot("marmotte"), make_log(6.0)
    cuts = [log.start + k * 2 * SECOND for k in range(4)]
    parts = [
        written(log.between(cuts[k], cuts[k + 1] - 1), tmp_path / f"part-{k}") for k in range(3)
    ]
    joined = read_log([parts[0], parts[2], parts[1]], robot)
    whole = log.between(cuts[0], cuts[3] - 1)
    assert len(joined.tracks.stamps) == len(whole.tracks.stamps)
    assert (joined.tracks.stamps == whole.tracks.stamps).all()


def test_two_recordings_of_the_same_time_are_refused(tmp_path: Path) -> None:
    robot = load_robot("marmotte")
    paths = [written(make_log(4.0, seed), tmp_path / f"run-{seed}") for seed in (1, 2)]
    with pytest.raises(ReplayError, match=r"both hold .* for the same 4 s: two recordings"):
        read_log(paths, robot)


def test_recordings_that_are_days_apart_are_refused(tmp_path: Path) -> None:
    robot = load_robot("marmotte")
    start = make_log().start
    paths = [
        written(make_log(4.0, start=start + days * 86_400 * SECOND), tmp_path / f"day-{days}")
        for days in (0, 3)
    ]
    with pytest.raises(ReplayError, match="3 days apart"):
        read_log(paths, robot)


def test_a_part_without_fixes_is_refused() -> None:
    log = make_log(6.0)
    assert log.fixes is not None
    early = replace(log, fixes=log.fixes)
    with pytest.raises(ReplayError, match=r"holds none of its \d+ fixes, which come from"):
        with_fixes_within(early, parse_part("500:600"))
