"""What people type in a notebook works, or says what to type."""

from pathlib import Path

import pytest

import icreckon
from icreckon.estimator.base.errors import EstimatorError
from icreckon.replay.base.errors import ReplayError


@pytest.fixture(scope="module")
def log() -> icreckon.Log:
    return icreckon.simulate(
        icreckon.Scenario(duration=60.0, fix_rate=1.0), icreckon.load_robot("auriga-alpha")
    )


def test_one_variant_and_a_part_as_texts(log: icreckon.Log, tmp_path: Path):
    robot = icreckon.load_robot("auriga-alpha")
    found = icreckon.compare(log, robot, "gyro", fixes="0:40%")
    assert list(found.runs) == ["gyro"]
    results = icreckon.summarise(found, robot, command="notebook", configuration={})
    icreckon.write_report(str(tmp_path), found, results, robot, formats=())
    assert (tmp_path / "page.html").exists()
    with pytest.raises(ReplayError, match="no such folder; make it first"):
        icreckon.write_report(str(tmp_path / "none"), found, results, robot)
    with pytest.raises(ReplayError, match="no part of a log"):
        icreckon.compare(log, robot, "gyro", fixes="the first half")


def test_part_takes_seconds_and_between_stamps(log: icreckon.Log):
    part = log.part(10.0, 20.0)
    assert part.start == log.start + 10_000_000_000
    assert part.duration == pytest.approx(10.0)
    assert len(log.between(part.start, part.end).imu.stamps) == len(part.imu.stamps)
    with pytest.raises(EstimatorError, match=r"part\(0.0, 10.0\) takes seconds"):
        log.between(0, 10)
