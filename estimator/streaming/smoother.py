"""Fixed-interval smoothing: estimates from earlier and later measurements.

The forward pass is the filter itself, to rounding. With it runs a linear Kalman filter for the error of
the filter's state, x = x_filter + delta. The linear filter has the same transitions, noise, Jacobians,
standstill updates and gates, but the optimal gain throughout.

The filter's own estimates cannot be smoothed. Its fixed states (Schmidt-Kalman: twist measurements do not
move the pose) are not optimal given the measurements so far. The recursion of Rauch, Tung and Striebel
assumes that they are: it would leave the pose at the end where it is, and bend the path before it. The
reason for a fixed pose does not hold here: a smoothed path has no jumps, and all Jacobians are those of
the filter's states. That for fixed parameters does: the IMU would attribute other errors of the motion
to them, and the gyro to gravity. So it does not see them: their part of an accelerometer's innovation
counts as noise, and the gyro's yaw rate is all of the turning, theirs too.

The backward pass is the modified Bryson-Frazier form of that recursion (Bierman, Fixed interval smoothing
with discrete measurements, International Journal of Control 18, 1973; the same estimates as those of
Simon, Optimal State Estimation, section 9.4, and Särkkä, Bayesian Filtering and Smoothing, section 8.2):

    x_smoothed = x - P lambda      P_smoothed = P - P Lambda P
    over a step, backward:         lambda <- F' lambda              Lambda <- F' Lambda F
    over an update, backward:      lambda <- C' lambda - h' y / S   Lambda <- C' Lambda C + h' h / S

with h the Jacobian's row, y the innovation, S its variance, k the gain and C = I - k h. No matrix is
inverted. So states of zero variance need no special case, nor does the fast slip, which is drawn again
with each step (there F has zeros).

After the last fix the path is turned as a whole, and not stretched (`unstretched`). Smoothed parameters
are projected onto their bounds as the filter's are. If the heading is lost (`LOST_YAW`: after long gaps
of a log), the pose cannot be linearised, and it is not smoothed across.

The last smoothed estimate is that of the optimal gain. It is the filter's own if there were no fixed
states (tracks and fixes alone), and otherwise as certain to a thousandth, or more.

Memory: some 1.5 kB for each IMU sample (the pose's rows of F, and each update's row and gain), and 2.2 kB
for each row of the result (the upper triangle of its covariance). An hour at 100 Hz of IMU and 50 Hz of
track speeds needs 1.3 GB.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import rotate
from icreckon.estimator.filter.changes import Moved, Updated
from icreckon.estimator.filter.ekf import WHOLE, Ekf, fade_wander, replaced_states
from icreckon.estimator.filter.process_noise import twist_covariance
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.streaming.outputs import Run, Snapshot
from icreckon.estimator.streaming.pose_estimator import PoseEstimator
from icreckon.estimator.streaming.run import Rows, work_through

SMOOTHED = "-smoothed"
LOST_YAW = 1.0  # a heading less certain than this is lost [rad]


class Smoothing(NamedTuple):
    """A run over a log, forward and smoothed.

    Attributes:
        filtered: the run of `run`, to rounding.
        smoothed: smoothed run at the same stamps; its `variant` ends in "-smoothed", and its `health` is
            the filter's.
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
    """Run one filter variant over a log, and smooth it; arguments are those of `run`.

    Raises:
        EstimatorError: no such variant, a log without track speeds, or considered states in `settings`.
    """
    if settings is not None and settings.considered:
        raise EstimatorError(
            "smoothing corrects all uncertain states, also those that Settings.considered names "
            f"({', '.join(settings.considered)}); smooth without it, or set their uncertainty to zero"
        )
    estimator = _TapedEstimator(
        robot, variant, settings=settings, start=start, start_sigma=start_sigma
    )
    filtered = work_through(log, estimator, progress, at_row=estimator.record_row)
    return Smoothing(filtered, estimator.tape.smoothed(filtered))


class _TapedEstimator(PoseEstimator):
    """Pose estimator with a tape of its changes; measurements come in order only."""

    def __init__(self, robot: Robot, variant: str, **options: Any) -> None:
        super().__init__(robot, variant, **options)
        self.tape = _Tape(self._reckoning.ekf, robot.vehicle.max_track_speed)

    def record_row(self) -> None:
        """Record the state of a row of the result."""
        self.tape.record_row(self._reckoning.track_speeds)


class _Step(NamedTuple):
    """Transition of a step."""

    moved_rows: Floats  # rows of F for pose and height
    decay: Floats  # (3,) decay factors of the slip
    gravity_rows: Floats  # rows of F for gravity


class _Renewal(NamedTuple):
    """States drawn independently of all before: the fast slip, or a lost pose."""

    states: list[int]


class _Wander(NamedTuple):
    """Decay of the wander of the fixes over some time."""

    decay: float


class _Update(NamedTuple):
    """Scalar update: Jacobian's row h, gain k, innovation y and its variance S."""

    h: Floats
    gain: Floats
    innovation: float
    S: float


class _RowState(NamedTuple):
    """State at a row of the result."""

    length: int  # length of the tape before it
    delta: Floats  # (SIZE,) optimal estimate of the error of the filter's state
    upper: Floats  # upper triangle of its covariance
    speeds: tuple[float, float]  # track speeds [m/s]
    model_memory: Floats  # (m,) checkpoint of the motion model's memory
    wander: Floats  # (2,) wander of the fixes in the filter's state, or nothing


class _Tape:
    """Observer of a filter: tape of its changes, and optimal filter of its error."""

    def __init__(self, ekf: Ekf, max_track_speed: float) -> None:
        self._ekf, self._max_track_speed = ekf, max_track_speed
        ekf.observer = self
        self._size = len(ekf.x)
        self._upper = np.triu_indices(self._size)
        self._delta: Floats = np.zeros(self._size)
        self._optimal_P: Floats = ekf.P.copy()
        self._tape: list[_Event] = []
        self._rows: list[_RowState] = []
        # Places of parameters and gravity that do not turn the robot in the present step.
        self._not_turning: list[int] = []
        self._row_of_fix = 0  # row at or after the newest measurement of the position

    # --- forward ---------------------------------------------------------------------------------

    def moved(self, step: Moved) -> None:
        """Record a transition, see `Observer`."""
        F = self.of_step(step.F)
        self._not_turning = []
        self._delta = F @ self._delta
        P = F @ self._optimal_P @ F.T + step.Q
        self._optimal_P = 0.5 * (P + P.T)
        self._tape.append(_Step(F[s.MOVED].copy(), np.diag(F)[s.SLIP].copy(), F[s.GRAVITY].copy()))
        if P[s.YAW, s.YAW] > LOST_YAW**2:
            self._renew([s.X, s.Y, s.YAW], self._optimal_P[s.POSE, s.POSE].copy())

    def renewed(self, covariance: Floats) -> None:
        """Record a new fast slip, see `Observer`."""
        self._renew([*range(s.FAST_SLIP.start, s.FAST_SLIP.stop)], covariance)

    def replaced(self, covariance: Floats) -> None:
        """Record a relocated pose, see `Observer`."""
        self._renew(replaced_states(covariance), covariance)

    def wandered(self, decay: float, variance: float) -> None:
        """Record the wander of the fixes over some time, see `Observer`."""
        self._delta[s.WANDER] *= decay
        P = self._optimal_P
        fade_wander(P, decay)
        P[[s.WANDER_X, s.WANDER_Y], [s.WANDER_X, s.WANDER_Y]] += variance
        self._tape.append(_Wander(decay))

    def _renew(self, states: list[int], covariance: Floats) -> None:
        """Draw states again: without error, correlated with no other."""
        self._delta[states] = 0.0
        P = self._optimal_P
        P[states, :] = P[:, states] = 0.0
        P[np.ix_(states, states)] = covariance
        self._tape.append(_Renewal(states))

    def inflated(self, states: Sequence[int], covariance: Floats, yaw: float | None = None) -> None:
        """Record an inflation, see `Observer`."""
        del yaw
        self._optimal_P[np.ix_(states, states)] += covariance

    def updated(self, change: Updated) -> None:
        """Record a scalar update, see `Observer`."""
        if s.X not in change.fixed and (change.h[s.X] or change.h[s.Y]):
            self._row_of_fix = len(self._rows)
        h, r = self.without_fixed(change.h, change.r, change.fixed)
        cross = self._optimal_P @ h
        S = float(h @ cross) + r
        gain = cross / S
        innovation = change.z - float(h @ self._delta)
        self._delta = self._delta + gain * innovation - change.gain * change.z
        self._optimal_P = self._optimal_P - np.outer(gain, cross)
        self._tape.append(_Update(h, gain, innovation, S))

    def without_fixed(self, h: Floats, r: float, fixed: tuple[int, ...]) -> tuple[Floats, float]:
        """Jacobian without fixed parameters, and the noise with their uncertainty."""
        unseen = [state for state in fixed if s.PARAMETERS.start <= state < s.SIZE]
        if not unseen:
            return h, r
        h_unseen, h = h[unseen], h.copy()
        h[unseen] = 0.0
        if h[s.GYRO_BIAS]:
            # The gyro measures the whole yaw rate: in this step the yaw does not depend on them.
            self._not_turning = unseen
            return h, r
        return h, r + float(h_unseen @ self._optimal_P[np.ix_(unseen, unseen)] @ h_unseen)

    def of_step(self, F: Floats) -> Floats:
        """Transition of the error; parameters that the gyro does not see turn no robot."""
        F = F.copy()
        F[s.YAW, self._not_turning] = 0.0
        return F

    def projected(self, change: Floats) -> None:
        """Record a projection onto bounds; the optimal filter itself is not projected."""
        self._delta = self._delta - change

    def record_row(self, track_speeds: tuple[float, float]) -> None:
        """Record the state of the optimal filter at a row of the result."""
        upper, memory = self._optimal_P[self._upper], self._ekf.model.memory.copy()
        wander, delta = self._ekf.x[s.SIZE :].copy(), self._delta.copy()
        self._rows.append(_RowState(len(self._tape), delta, upper, track_speeds, memory, wander))

    # --- backward --------------------------------------------------------------------------------

    def smoothed(self, filtered: Run) -> Run:
        """Smooth a run backward over the tape; consumes the tape, overwrites the filter."""
        ekf = self._ekf
        ekf.observer = ekf.clones = None
        count, size = len(self._rows), self._size
        rows = Rows(count)
        # lambda and Lambda of the recursion.
        adjoint, information = np.zeros(size), np.zeros((size, size))
        for index in reversed(range(count)):
            row = self._rows.pop()
            while len(self._tape) > row.length:
                adjoint, information = _back(self._tape.pop(), adjoint, information)
            P = np.zeros((size, size))
            P[self._upper] = P.T[self._upper] = row.upper  # both triangles
            smoothed_P = P - P @ information @ P
            ekf.x = np.append(filtered.states[index], row.wander) + row.delta - P @ adjoint
            ekf.P = 0.5 * (smoothed_P + smoothed_P.T)
            # Rounding may make a variance of zero negative.
            np.fill_diagonal(ekf.P, np.maximum(ekf.P.diagonal(), 0.0))
            ekf.keep_inside_bounds()
            ekf.model.recall(row.model_memory)
            model = ekf.evaluation(ekf, *row.speeds, WHOLE)
            twist_P = twist_covariance(model.jacobian, ekf.P, self._max_track_speed)
            # Rows are without the wander of the fixes.
            x, row_P = ekf.x[: s.SIZE], ekf.P[: s.SIZE, : s.SIZE]
            stamp, indices = int(filtered.stamps[index]), model.motion.indices
            rows.put(index, Snapshot(stamp, x, row_P, model.twist, twist_P, indices))
        if count:
            poses, anchor = rows.arrays.states[:, s.POSE], min(self._row_of_fix, count - 1)
            poses[:] = unstretched(filtered.trajectory.poses, poses, anchor)
        name = filtered.variant + SMOOTHED
        return rows.finish(count, name, filtered.state_names, filtered.health)


def unstretched(filtered: Floats, smoothed: Floats, anchor: int) -> Floats:
    """Smoothed poses (n, 3) whose path after an anchor is turned, and not stretched.

    Without fixes the yaw's correction grows with the log, and the position's correction is linear in it:
    a path turned by 0.4 rad in this way is 8 % too long. So the corrections of the motion from row to row
    are separated from the turn, each motion is corrected and turned, and the path composed again from the
    row `anchor`. The smoothed poses are those of the filter (n, 3) plus linear corrections.
    """
    turn = smoothed[:, 2] - filtered[:, 2]
    step = np.diff(filtered[:, :2], axis=0)
    # To first order a turn moves the end of a step across it: the rest corrects the motion itself.
    across = np.column_stack([-step[:, 1], step[:, 0]])
    correction = np.diff(smoothed[:, :2] - filtered[:, :2], axis=0) - turn[:-1, None] * across
    turned = rotate(step + correction, turn[:-1])
    result = smoothed.copy()
    result[anchor + 1 :, :2] = smoothed[anchor, :2] + np.cumsum(turned[anchor:], axis=0)
    return result


_Event = _Step | _Renewal | _Wander | _Update


def _back(event: _Event, adjoint: Floats, information: Floats) -> tuple[Floats, Floats]:
    """Compute lambda and Lambda before an event on the tape from those after it."""
    match event:
        case _Update(h, gain, innovation, S):
            adjoint = adjoint - h * (float(gain @ adjoint) + innovation / S)
            # C' Lambda C + h' h / S, as Lambda less a symmetric matrix of rank two.
            with_gain = information @ gain
            half = with_gain - h * (0.5 * (float(gain @ with_gain) + 1.0 / S))
            one_side = np.outer(h, half)
            return adjoint, information - (one_side + one_side.T)
        case _Renewal(states):
            adjoint = adjoint.copy()
            adjoint[states] = 0.0
            information = information.copy()
            information[states, :] = information[:, states] = 0.0
            return adjoint, information
        case _Wander(decay):
            adjoint, information = adjoint.copy(), information.copy()
            adjoint[s.WANDER] *= decay
            fade_wander(information, decay)
            return adjoint, information
        case _Step(moved_rows, decay, gravity_rows):
            F = np.eye(len(adjoint))
            F[s.MOVED] = moved_rows
            F[s.SLIP, s.SLIP] = np.diag(decay)
            F[s.GRAVITY] = gravity_rows
            return adjoint @ F, F.T @ information @ F
