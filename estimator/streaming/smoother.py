"""Fixed-interval smoothing of a log: each estimate from all measurements, those after it included.

The forward pass is the filter itself, to the last bit. Beside it runs a linear Kalman filter for the
error of the filter's state, x = x_filter + delta: with the same transitions, noise, Jacobians, standstill
updates and gates, but with the optimal gain throughout. The filter's own estimates cannot be smoothed as
they are. Where it keeps states (Schmidt-Kalman: what measures the twist does not move the pose) they are
not the best ones given the measurements so far, and the recursion of Rauch, Tung and Striebel, which
takes them for that, would leave the pose at the end where it is and bend the path before it. What the
filter avoids by keeping does not matter here: a smoothed path has no jumps, and all Jacobians stay those
of the filter's states.

The backward pass is the modified Bryson-Frazier form of that recursion (Bierman, Fixed interval smoothing
with discrete measurements, International Journal of Control 18, 1973; the same estimates as those of
Simon, Optimal State Estimation, section 9.4, and Särkkä, Bayesian Filtering and Smoothing, section 8.2):

    x_smoothed = x - P lambda      P_smoothed = P - P Lambda P
    over a step, backward:         lambda <- F' lambda              Lambda <- F' Lambda F
    over an update, backward:      lambda <- C' lambda - h' y / S   Lambda <- C' Lambda C + h' h / S

with h the Jacobian's row, y the innovation, S its variance, k the gain and C = I - k h. Nothing is
inverted, so states that are known exactly need no special care, nor does the fast slip, which is drawn
anew with each step (there F has zeros).

Smoothed parameters are brought inside their bounds as the filter's are. Where the heading is lost
(`LOST_YAW`: long holes of a log) nothing linear can be said of the pose, and it is not smoothed across.

The last smoothed estimate is that of the optimal gain: the filter's own where nothing was kept (tracks
and fixes alone), otherwise at least as certain.

Memory: some 1.5 kB for each IMU sample (the rows of F that are not trivial, and each update's row and
gain), and 2.2 kB for each row of the result (the upper triangle of its covariance): 1.3 GB for an hour at
100 Hz of IMU and 50 Hz of track speeds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.filter.ekf import IDENTITY, SLIP_DIAGONAL, IcrEkf
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.pose_estimator import PoseEstimator, Snapshot
from icreckon.estimator.streaming.recorded_run import Run
from icreckon.estimator.streaming.run import Rows, work_through

SMOOTHED = "-smoothed"
UPPER = np.triu_indices(s.SIZE)
# A heading less certain than this is lost [rad].
LOST_YAW = 1.0


class Smoothing(NamedTuple):
    """A run over a log, forward and smoothed.

    Attributes:
        filtered: the run of `run`, to rounding.
        smoothed: the same at the same stamps from all measurements; its `variant` ends in "-smoothed".
            Its `health` is the filter's.
    """

    filtered: Run
    smoothed: Run


def smooth(
    log: Log,
    robot: Robot,
    variant: str,
    *,
    settings: Settings | None = None,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    start_sigma: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Callable[[int], None] | None = None,
) -> Smoothing:
    """Run one filter variant over a log, and smooth it.

    Args:
        log: the measurements; its truth is not looked at.
        robot: the robot.
        variant: name of a filter variant.
        settings: of the pose estimator.
        start: pose at the start: x, y [m], yaw [rad].
        start_sigma: its standard deviations [m, m, rad].
        progress: called now and then with the stamp [ns] that the filter has reached.

    Raises:
        EstimatorError: no such variant, a log without track speeds, or states that are only considered.
    """
    if settings is not None and settings.considered:
        raise EstimatorError(
            "smoothing corrects all that it can, and cannot leave alone what Settings.considered names "
            f"({', '.join(settings.considered)}); smooth without it, or give these no uncertainty"
        )
    estimator = _TapedEstimator(
        robot, variant, settings=settings, start=start, start_sigma=start_sigma
    )
    filtered = work_through(log, estimator, progress, at_row=estimator.keep_row)
    return Smoothing(filtered, estimator.tape.smoothed(filtered))


class _TapedEstimator(PoseEstimator):
    """A pose estimator of which a tape keeps what the smoother needs; fed in order only."""

    def __init__(
        self,
        robot: Robot,
        variant: str,
        *,
        settings: Settings | None,
        start: tuple[float, float, float],
        start_sigma: tuple[float, float, float],
    ) -> None:
        super().__init__(robot, variant, settings=settings, start=start, start_sigma=start_sigma)
        self.tape = _Tape(self._reckoning.ekf)

    def keep_row(self) -> None:
        """Remember that a row of the result is to be here."""
        self.tape.keep_row(self._reckoning.track_speeds)


class _Step(NamedTuple):
    """A transition: its rows for the pose, and what the slip decays by."""

    pose_rows: Floats
    decay: float


class _Renewal(NamedTuple):
    """States were drawn anew, independent of all before: the fast slip, or a pose that was lost."""

    states: slice


class _Update(NamedTuple):
    """A scalar measurement: h, k, y and S."""

    row: Floats
    gain: Floats
    innovation: float
    expected: float


class _KeptRow(NamedTuple):
    """What is known where a row of the result is to be: how much was on the tape, and with it ..."""

    length: int
    delta: Floats
    upper: Floats
    speeds: tuple[float, float]
    model_memory: Floats


class _Tape:
    """Observer of a filter: tape of its changes, and of the optimal filter for its error.

    Args:
        ekf: the filter at its start.
    """

    def __init__(self, ekf: IcrEkf) -> None:
        self._ekf = ekf
        ekf.observer = self
        self._delta: Floats = np.zeros(s.SIZE)
        self._optimal_P: Floats = ekf.P.copy()
        self._tape: list[_Step | _Renewal | _Update] = []
        self._rows: list[_KeptRow] = []

    # --- forward ---------------------------------------------------------------------------------

    def moved(self, F: Floats, Q: Floats) -> None:
        """See `Observer`."""
        self._delta = F @ self._delta
        P = F @ self._optimal_P @ F.T + Q
        self._optimal_P = 0.5 * (P + P.T)
        self._tape.append(_Step(F[s.POSE].copy(), F.item(s.SLIP_X, s.SLIP_X)))
        if P[s.YAW, s.YAW] > LOST_YAW**2:
            self._renew(s.POSE, self._optimal_P[s.POSE, s.POSE].copy())

    def renewed(self, covariance: Floats) -> None:
        """See `Observer`."""
        self._renew(s.FAST_SLIP, covariance)

    def replaced(self, covariance: Floats) -> None:
        """See `Observer`."""
        self._renew(s.POSE, covariance)

    def _renew(self, states: slice, covariance: Floats) -> None:
        self._delta[states] = 0.0
        P = self._optimal_P
        P[states, :] = P[:, states] = 0.0
        P[states, states] = covariance
        self._tape.append(_Renewal(states))

    def inflated(self, states: tuple[int, ...], variance: float) -> None:
        """See `Observer`."""
        for index in states:
            self._optimal_P[index, index] += variance

    def updated(self, z: float, h: Floats, r: float, change: Floats) -> None:
        """See `Observer`."""
        cross = self._optimal_P @ h
        expected = float(h @ cross) + r
        gain = cross / expected
        innovation = z - float(h @ self._delta)
        self._delta = self._delta + gain * innovation - change
        self._optimal_P = self._optimal_P - np.outer(gain, cross)
        self._tape.append(_Update(h, gain, innovation, expected))

    def projected(self, change: Floats) -> None:
        """See `Observer`; the optimal filter stays where it is, only smoothed states are projected."""
        self._delta = self._delta - change

    def keep_row(self, track_speeds: tuple[float, float]) -> None:
        """Remember that a row of the result is to be here."""
        P, memory = self._optimal_P[UPPER], self._ekf.model.memory
        row = _KeptRow(len(self._tape), self._delta.copy(), P, track_speeds, memory)
        self._rows.append(row)

    # --- backward --------------------------------------------------------------------------------

    def smoothed(self, filtered: Run) -> Run:
        """Go back over the tape, which is used up, as is the filter.

        Args:
            filtered: what the filter said where rows were kept.
        """
        ekf = self._ekf
        ekf.observer = ekf.clones = ekf.regressors = None
        count = len(self._rows)
        rows = Rows(count)
        adjoint, information = np.zeros(s.SIZE), np.zeros((s.SIZE, s.SIZE))
        for index in reversed(range(count)):
            row = self._rows.pop()
            while len(self._tape) > row.length:
                adjoint, information = _back(self._tape.pop(), adjoint, information)
            P = np.zeros((s.SIZE, s.SIZE))
            P[UPPER] = row.upper
            P.T[UPPER] = row.upper
            smoothed_P = P - P @ information @ P
            ekf.x = filtered.states[index] + row.delta - P @ adjoint
            ekf.P = 0.5 * (smoothed_P + smoothed_P.T)
            # What is known exactly may come out less certain than nothing by a rounding.
            np.fill_diagonal(ekf.P, np.maximum(ekf.P.diagonal(), 0.0))
            ekf.keep_inside_bounds()
            ekf.model.recall(row.model_memory)
            model = ekf.twist_model(*row.speeds)
            rows.put(
                index,
                Snapshot(
                    int(filtered.stamps[index]),
                    ekf.x,
                    ekf.P,
                    model.twist,
                    model.jacobian @ ekf.P @ model.jacobian.T,
                    model.motion.indices,
                ),
            )
        return rows.finish(
            count, filtered.variant + SMOOTHED, filtered.state_names, filtered.health
        )


def _back(
    event: _Step | _Renewal | _Update, adjoint: Floats, information: Floats
) -> tuple[Floats, Floats]:
    """What lambda and Lambda were before an event on the tape, from those after it."""
    match event:
        case _Update(row, gain, innovation, expected):
            adjoint = adjoint - row * (float(gain @ adjoint) + innovation / expected)
            with_gain = information @ gain
            half = with_gain - row * (0.5 * (float(gain @ with_gain) + 1.0 / expected))
            turned = np.outer(row, half)
            return adjoint, information - (turned + turned.T)
        case _Renewal(states):
            adjoint = adjoint.copy()
            adjoint[states] = 0.0
            information = information.copy()
            information[states, :] = information[:, states] = 0.0
            return adjoint, information
        case _Step(pose_rows, decay):
            F = IDENTITY.copy()
            F[s.POSE] = pose_rows
            F.ravel()[SLIP_DIAGONAL] = decay
            return adjoint @ F, F.T @ information @ F
