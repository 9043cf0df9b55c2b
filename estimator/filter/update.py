"""Gated updates of the filter: what is used, what is refused, and what is counted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from icreckon.estimator.filter.ekf import IcrEkf
from icreckon.estimator.filter.gate import REACQUIRED, REJECTED, Gate, reopening
from icreckon.estimator.filter.health import SensorHealth
from icreckon.estimator.filter.joint import Joint
from icreckon.estimator.filter.look_ahead import Foretold, Surprise, component
from icreckon.estimator.sensors.sensor_models import Reading


class Judge(NamedTuple):
    """What says whether a measurement is used, and counts it.

    Attributes:
        stamp: of the measurement [ns].
        gate: of its sensor.
        health: of its sensor.
    """

    stamp: int
    gate: Gate
    health: SensorHealth

    def judge(self, surprise: Surprise) -> int:
        """The verdict on numbers that were measured together, which is counted."""
        residual, spread, nis = surprise
        verdict, rows = self.gate.judge(nis), spread.tolist()
        judged = self.stamp, verdict, tuple(residual.tolist()), tuple(map(tuple, rows))
        self.health.judged(verdict, nis, len(rows), judged)
        return verdict


def update(
    ekf: IcrEkf, judge: Judge, reading: Reading, *, reopen: int, kept: tuple[int, ...]
) -> bool:
    """With one number; whether it was used.

    Args:
        ekf: the filter.
        judge: of the sensor.
        reading: the number.
        reopen: the state that is made uncertain first when re-acquiring; where it is one that is only
            considered, the number is taken as that much less certain instead.
        kept: states that are not to be moved.
    """
    innovation = ekf.innovation(*reading)
    residual, expected, nis = reading.residual, innovation.variance, innovation.nis
    verdict = judge.gate.verdict(nis)
    if verdict == REACQUIRED:
        wider = reopening(residual * residual, expected)
        if reopen in ekf.considered:
            by_state = reading.row.item(reopen)
            reading = reading._replace(variance=reading.variance + wider * (by_state * by_state))
        else:
            ekf.reopen(reopen, variance=wider)
    if verdict != REJECTED:
        ekf.update_scalar(*reading, kept=kept)
    judge.gate.count(verdict)
    judged = judge.stamp, verdict, (residual,), ((expected,),)
    return judge.health.judged(verdict, nis, 1, judged)


def update_pair(
    ekf: IcrEkf,
    judge: Judge,
    values: tuple[float, float],
    variance: float,
    foretold: Foretold,
    *,
    reopen: int,
    kept: tuple[int, ...],
) -> bool:
    """With the first two of three numbers, both or none; whether they were used.

    Args:
        ekf: the filter.
        judge: of the sensor.
        values: what was measured.
        variance: of each.
        foretold: all three, at the present state.
        reopen: the first of the two states that are made uncertain when re-acquiring.
        kept: states that are not to be moved.
    """
    foretold_at = ekf.x.copy()
    surprise = surprise_of(ekf, values, variance, foretold)
    verdict = judge.judge(surprise)
    if verdict == REACQUIRED:
        residual, expected = surprise.residual, float(surprise.spread.diagonal().min())
        both = (reopen, reopen + 1)
        ekf.reopen(*both, variance=reopening(float(residual @ residual), expected))
    if verdict != REJECTED:
        for axis, value in enumerate(values):
            reading = component(axis, value, variance, foretold, foretold_at, ekf.x)
            ekf.update_scalar(*reading, kept=kept)
        ekf.keep_inside_bounds()
    return verdict != REJECTED


def surprise_of(
    ekf: IcrEkf, values: tuple[float, float], variance: float, foretold: Foretold
) -> Surprise:
    """How far two measured numbers are from the first two of those foretold.

    Args:
        ekf: the filter.
        values: what was measured.
        variance: of each.
        foretold: all three, at the present state.
    """
    residual = np.array(values) - foretold.values[:2]
    rows = foretold.by_state[:2]
    spread = rows @ ekf.P @ rows.T + foretold.covariance[:2, :2] + variance * np.eye(2)
    return Surprise(residual, spread, float(residual @ np.linalg.solve(spread, residual)))


def update_jointly(
    ekf: IcrEkf, judge: Judge, joint: Joint, *, reopen: int, kept: tuple[int, ...]
) -> bool:
    """With three numbers, all or none; whether they were used.

    Args:
        ekf: the filter.
        judge: of the sensor.
        joint: the numbers.
        reopen: the first of the three states that are made uncertain when re-acquiring, each by as much
            as its own number is off.
        kept: states that are not to be moved.
    """
    surprise = joint.surprise(ekf.P)
    verdict = judge.judge(surprise)
    if verdict == REACQUIRED:
        squares, expected = surprise.residual**2, surprise.spread.diagonal()
        for axis in range(3):
            wider = reopening(squares.item(axis), expected.item(axis))
            ekf.reopen(reopen + axis, variance=wider)
    if verdict != REJECTED:
        for reading in joint.readings():
            ekf.update_scalar(*joint.left_of(reading, ekf.x), kept=kept)
        ekf.keep_inside_bounds()
    return verdict != REJECTED
