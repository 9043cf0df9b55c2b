"""Arguments of another kind: the error names the argument and what it must be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import icreckon
from icreckon.estimator.log.log import Log
from icreckon.estimator.log.series import ImuSeries, PoseSeries, TrackSpeedSeries, Truth

ROBOT = icreckon.load_robot("auriga-alpha")
STAMPS = np.arange(50) * 20_000_000
TRACKS = TrackSpeedSeries(STAMPS, np.full((50, 2), 0.2))
IMU = ImuSeries(STAMPS, np.zeros((50, 3)))
LOG = Log("a", TRACKS, IMU)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: TrackSpeedSeries(STAMPS * 1e-9, np.zeros((50, 2))), r"integers \[ns\].*astype"),
        (lambda: TrackSpeedSeries([1, 2], np.zeros((2, 2))), "stamps must be a numpy array"),
        (lambda: ImuSeries(STAMPS, [[0.0] * 3] * 50), "angular_velocity must be a numpy array"),
        (lambda: Truth(np.zeros((3, 3))), r"poses must be PoseSeries\(\.\.\.\), found ndarray"),
        (lambda: Log("x", IMU), r"tracks must be TrackSpeedSeries\(\.\.\.\), found ImuSeries"),
        (lambda: Log(TRACKS, IMU), "name must be str"),
        (lambda: Log("x", TRACKS, imu=TRACKS), "imu must be ImuSeries.* or None, found TrackSp"),
        (lambda: Log("x", TRACKS, truth=PoseSeries(STAMPS, np.zeros((50, 3)))), "truth must be"),
        (lambda: icreckon.compare(ROBOT, LOG), r"log must be Log\(\.\.\.\), found Robot"),
        (lambda: icreckon.compare(LOG, "warthog"), "robot must be a Robot"),
        (lambda: icreckon.run(ROBOT, LOG, "gyro"), r"log must be Log\(\.\.\.\), found Robot"),
        (lambda: icreckon.calibrate([TRACKS], ROBOT), "each of logs must be Log"),
        (lambda: icreckon.calibrate("a.mcap", ROBOT), "each of logs must be Log.*found str"),
        (lambda: icreckon.simulate(ROBOT, icreckon.Scenario()), "scenario must be Scenario"),
    ],
)
def test_it_is_named(make: Any, words: str) -> None:
    with pytest.raises(icreckon.IcreckonError, match=words) as found:
        make()
    assert len(str(found.value)) < 300


def test_one_log_is_as_good_as_a_list_of_one() -> None:
    with pytest.raises(icreckon.EstimatorError, match="truth") as alone:
        icreckon.calibrate(LOG, ROBOT)
    with pytest.raises(icreckon.EstimatorError, match="truth") as listed:
        icreckon.calibrate([LOG], ROBOT)
    assert str(alone.value) == str(listed.value)
