"""Fixed-interval smoothing: estimates from earlier and later measurements.

The forward pass is the filter itself, to rounding. The backward pass corrects each of its states by the
innovations that follow:

    x_smoothed = x - P lambda      P_smoothed = P - P Lambda P
    over a step, backward:         lambda <- F' lambda              Lambda <- F' Lambda F
    over an update, backward:      lambda <- C' lambda - h' y / S   Lambda <- C' Lambda C + h' h / S

with h the Jacobian's row, y the innovation, S its variance, and C = I - (P h' / S) h. That is the
modified Bryson-Frazier form of the recursion of Rauch, Tung and Striebel (Bierman, Fixed interval
smoothing with discrete measurements, International Journal of Control 18, 1973; the same estimates as
those of Simon, Optimal State Estimation, section 9.4, and Särkkä, Bayesian Filtering and Smoothing,
section 8.2). No matrix is inverted. So states of zero variance need no special case, nor does the fast
slip, which is drawn again with each step (there F has zeros).

The filter's gains are not all optimal: what measures the twist does not move the pose (Schmidt-Kalman),
for errors of the model would move it, too. The same holds here. Such an update moves no earlier state,
and the recursion passes it with the filter's own gain k: C = I - k h, without the terms in y and S. P is
the covariance of the filter's error for any gain, and P lambda its covariance with the innovations that
follow. So the smoothed covariance is that of the smoothed error, and never larger than P. Where all gains
are optimal, as with tracks and fixes alone, the smoothed estimate is the best linear one.

So after the last fix a smoothed estimate is the filter's own. Smoothed parameters are projected onto
their bounds as the filter's are. If the heading is lost (`LOST_YAW`: after long gaps of a log), the pose
cannot be linearised, and nothing is smoothed across.

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
from icreckon.estimator.filter.changes import Moved, Updated
from icreckon.estimator.filter.ekf import WHOLE, Ekf, fade_wander, replaced_states
from icreckon.estimator.filter.process_noise import twist_covariance
from icreckon.estimator.log.log import Log
from icreckon.estimator.robot.robot_file import Robot
from icreckon.estimator.robot.settings import Settings
from icreckon.estimator.sensors.measurement_models import POSE_FIXED
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
    """Scalar update; `score` and `information` are zero if no earlier state moves."""

    h: Floats  # Jacobian's row
    gain: Floats
    score: float  # y / S
    information: float  # 1 / S


class _RowState(NamedTuple):
    """State at a row of the result."""

    length: int  # length of the tape before it
    upper: Floats  # upper triangle of the covariance
    speeds: tuple[float, float]  # track speeds [m/s]
    model_memory: Floats  # (m,) checkpoint of the motion model's memory
    wander: Floats  # (2,) wander of the fixes in the filter's state, or nothing


class _Tape:
    """Observer of a filter: tape of its changes."""

    def __init__(self, ekf: Ekf, max_track_speed: float) -> None:
        self._ekf, self._max_track_speed = ekf, max_track_speed
        ekf.observer = self
        self._size = len(ekf.x)
        self._upper = np.triu_indices(self._size)
        self._tape: list[_Event] = []
        self._rows: list[_RowState] = []

    # --- forward ---------------------------------------------------------------------------------

    def moved(self, step: Moved) -> None:
        """Record a transition, see `Observer`."""
        F = step.F
        self._tape.append(_Step(F[s.MOVED].copy(), np.diag(F)[s.SLIP].copy(), F[s.GRAVITY].copy()))
        if self._ekf.P[s.YAW, s.YAW] > LOST_YAW**2:
            self._tape.append(_Renewal([*range(self._size)]))

    def renewed(self, covariance: Floats) -> None:
        """Record a new fast slip, see `Observer`."""
        del covariance
        self._tape.append(_Renewal([*range(s.FAST_SLIP.start, s.FAST_SLIP.stop)]))

    def replaced(self, covariance: Floats) -> None:
        """Record a relocated pose, see `Observer`."""
        self._tape.append(_Renewal(replaced_states(covariance)))

    def wandered(self, decay: float, variance: float) -> None:
        """Record the wander of the fixes over some time, see `Observer`."""
        del variance
        self._tape.append(_Wander(decay))

    def inflated(self, states: Sequence[int], covariance: Floats, yaw: float | None = None) -> None:
        """Record nothing: an added error is independent of all before it, see `Observer`."""

    def updated(self, change: Updated) -> None:
        """Record a scalar update, see `Observer`."""
        moves_pose = not set(POSE_FIXED) <= set(change.fixed)
        information = 1.0 / change.S if moves_pose else 0.0
        gain = change.cross * information if moves_pose else change.gain
        self._tape.append(_Update(change.h, gain, information * change.z, information))

    def record_row(self, track_speeds: tuple[float, float]) -> None:
        """Record the state of the filter at a row of the result."""
        upper, memory = self._ekf.P[self._upper], self._ekf.model.memory.copy()
        wander = self._ekf.x[s.SIZE :].copy()
        self._rows.append(_RowState(len(self._tape), upper, track_speeds, memory, wander))

    # --- backward --------------------------------------------------------------------------------

    def smoothed(self, filtered: Run) -> Run:
        """Smooth a run backward over the tape; consumes the tape, overwrites the filter."""
        ekf = self._ekf
        ekf.observer = ekf.clones = None
        count, size = len(self._rows), self._size
        rows = Rows(count)
        # lambda (n,) and Lambda (n, n) of the recursion.
        adjoint, information = np.zeros(size), np.zeros((size, size))
        for index in reversed(range(count)):
            row = self._rows.pop()
            while len(self._tape) > row.length:
                adjoint, information = _back(self._tape.pop(), adjoint, information)
            P = np.zeros((size, size))
            P[self._upper] = P.T[self._upper] = row.upper  # both triangles
            smoothed_P = P - P @ information @ P
            ekf.x = np.append(filtered.states[index], row.wander) - P @ adjoint
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
        name = filtered.variant + SMOOTHED
        return rows.finish(count, name, filtered.state_names, filtered.health)


_Event = _Step | _Renewal | _Wander | _Update


def _back(event: _Event, adjoint: Floats, information: Floats) -> tuple[Floats, Floats]:
    """Compute lambda and Lambda before an event on the tape from those after it."""
    match event:
        case _Update(h, gain, score, own_information):
            adjoint = adjoint - h * (float(gain @ adjoint) + score)
            # C' Lambda C + h' h / S (zero for fixed poses) is Lambda less a symmetric matrix of rank two.
            with_gain = information @ gain
            half = with_gain - h * (0.5 * (float(gain @ with_gain) + own_information))
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
