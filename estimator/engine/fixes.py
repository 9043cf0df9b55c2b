"""Updates with fixes in traced numbers, as in `icreckon.estimator.filter.ekf`."""

import math
from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import NamedTuple

from icreckon.estimator.base import state as s
from icreckon.estimator.engine.covariance import Vector, combined, dot, shift_of
from icreckon.estimator.engine.lane import FilterShape, Lane, PlainNumbers
from icreckon.estimator.engine.layout import FACTORS, PLACE, TREND
from icreckon.estimator.engine.model import (
    departure_after,
    lasting_slip,
    normalised,
    patience_for,
    present_factor_after,
    slip_factor_after,
    trend_after,
    turn,
)
from icreckon.estimator.engine.step import Step, StepKind, TracedPose
from icreckon.estimator.faults.departing_fixes import STATES, Departure
from icreckon.estimator.filter.ekf import LEAST_VARIANCE
from icreckon.estimator.filter.filter_record import ALIKE_FIXES, DEPARTURE
from icreckon.estimator.filter.gate import LARGEST_INFLATION
from icreckon.estimator.filter.process_noise import UNKNOWN_YAW
from icreckon.estimator.filter.slip_factor import LARGEST_FACTOR
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.estimator.tracing import trace
from icreckon.estimator.tracing.kernel import Kernel
from icreckon.estimator.tracing.trace import Real, Truth, maximum, minimum, select

ALIKE_TO = 10.0  # factor between the variances of fixes that are not alike, as RTK float and fixed


class FixKind(NamedTuple):
    """Kind of a fix, on which the code of its kernel depends."""

    fast_slip: bool = False  # the fast slip of the newest step is still a state
    twist: bool = False  # compute the body velocity after it
    ahead: bool = False  # it lies between the end of the last step and that of the next
    updated: bool = True  # compute the place of the antenna after it


def position_kernel(
    name: str, shape: FilterShape, kind: FixKind, numbers: PlainNumbers | None = None
) -> Kernel:
    """Make the kernel of a position fix; see `Reckoning._take_fix`.

    The kernel returns two flags: lanes whose filter is lost, for the caller to relocate, and lanes that
    used the fix. For `numbers` see `Lane`.
    """
    lane = Lane(shape, numbers, with_fast_slip=kind.fast_slip)
    fix = _PositionFix(lane, kind)
    # The present slip may have lasted since the fix before.
    slipped = lasting_slip(lane.x[s.SLIP_X], fix.heading, fix.interval)
    fix.inflate((s.X, s.Y, s.SLIP_X), slipped, fix.judged)
    fix.follow_precision()
    # Fixes that the gate would reject may depart from the path, which makes the states uncertain.
    S, nis = fix.innovation_covariance()
    is_off = fix.judged & ~(nis <= lane.constant("position_threshold"))
    departure, departs = fix.follow_departure(S, is_off)
    S, nis = fix.innovation_covariance()
    verdict = fix.gate(nis)
    fix.store_departure(departure, is_off, verdict)
    fix.store_precision(verdict)
    fix.update(S, verdict)
    is_usable = verdict.admitted | verdict.reacquired
    lane.count("position", nis, verdict.admitted, is_usable, verdict.tested, fix.interval)
    fix.store_factors(S, departs, verdict.tested & verdict.admitted)
    # Outputs: places of the antenna, and the innovation.
    places = {"predicted": fix.predicted}
    if kind.updated:
        places["updated"] = _antenna(lane, _predicted(lane, kind)).values
    for when, place in places.items():
        lane.stores |= {f"{when}_{axis}": value for axis, value in zip(PLACE, place, strict=True)}
    for part, value in zip(("z_x", "z_y", "S_xx", "S_xy", "S_yy"), (*fix.z, *S), strict=True):
        row = f"position_{part}"
        lane.stores[row] = select(fix.is_tried, value, lane.row(row))
    return _finished(lane, name, (verdict.lost, verdict.used), kind)


class _Verdict(NamedTuple):
    """Verdict of the gate on a position fix: lanes in which each is true."""

    admitted: Truth  # the gate admits it
    reacquired: Truth  # forced, rejected, and used since those before were rejected for too long
    lost: Truth  # the same, but gated: the filter is to be relocated
    tested: Truth  # tried, and not lost
    used: Truth  # tested, and admitted or re-acquired


class _PositionFix:
    """Position fix, and its innovation about the predicted place of the antenna.

    Modes of a fix (`gate`) are 0, skipped; 1, gated; 2, forced.
    """

    def __init__(self, lane: Lane, kind: FixKind) -> None:
        self.lane = lane
        self.variance, mode = lane.input("fix_variance"), lane.input("fix_mode")
        self.predicted, self.rows, covariance = _antenna(lane, _predicted(lane, kind))
        x, y, yaw = self.predicted
        if s.WANDER_X in lane.shape.states:
            # The fix has the error that wanders, too.
            x, y = x + lane.x[s.WANDER_X], y + lane.x[s.WANDER_Y]
            self.rows[s.X][s.WANDER_X] = self.rows[s.Y][s.WANDER_Y] = 1.0
        self.expected = x, y
        self.place = lane.input("fix_x"), lane.input("fix_y")
        self.z = self.place[0] - x, self.place[1] - y
        self.noise_xy = covariance[s.X][s.Y]
        # What the linearised arm omits by the yaw's variance: its square is three quarters of that.
        spread = minimum(lane.P.entry(s.YAW, s.YAW), UNKNOWN_YAW)
        bent = [spread * self.rows[i].get(s.YAW, 0.0) for i in (s.X, s.Y)]
        variance = self.variance + (bent[s.X] * bent[s.X] + bent[s.Y] * bent[s.Y])
        self.R = [maximum(variance + covariance[i][i], LEAST_VARIANCE) for i in (s.X, s.Y)]
        self.interval, self.heading = lane.input("fix_interval"), turn(yaw)
        self.is_tried, self.is_forced = mode > 0.5, mode > 1.5
        self.judged = self.is_tried & (mode < 1.5)
        self.square = self.z[0] * self.z[0] + self.z[1] * self.z[1]

    def innovation_covariance(self) -> tuple[tuple[Real, Real, Real], Real]:
        """Innovation covariance xx, xy, yy [m²], and normalised innovation squared."""
        (z_x, z_y), (row_x, row_y, *_), P = self.z, self.rows, self.lane.P
        with_x, with_y = P.times(row_x), P.times(row_y)
        xx = dot(with_x, row_x) + self.R[s.X]
        xy = dot(with_x, row_y) + self.noise_xy
        yy = dot(with_y, row_y) + self.R[s.Y]
        by_x, by_y = z_x * yy - z_y * xy, z_y * xx - z_x * xy
        return (xx, xy, yy), (z_x * by_x + z_y * by_y) / (xx * yy - xy * xy)

    def inflate(self, states: Sequence[int], error: Sequence[Real], only: Truth) -> None:
        """Inflate by an error that moves several states, in some lanes."""
        moved = [select(only, part, 0.0) for part in error[: len(states)]]
        self.lane.P.add_error(dict(zip(states, moved, strict=True)))
        products = [a * b for a, b in combinations_with_replacement(moved, 2)]
        self.lane.report("motion", products, states)

    def inflate_one(self, state: int, variance: Real) -> None:
        """Inflate one state by a variance."""
        self.lane.P.add_error({state: 1.0}, variance)
        self.lane.report("inflated", (variance,), (state,))

    def follow_precision(self) -> None:
        """Inflate the position for a fix that is far more precise than those before.

        These n fixes of variance R were used as if their errors were independent. RTK that floats has one
        error: the information of all but one is taken back, 1/P - (n - 1)/R. The variance gets at most R.
        """
        lane, (before, count) = self.lane, (self.lane.row(name) for name in ALIKE_FIXES)
        is_sharp = self.judged & (self.variance * ALIKE_TO < before)
        for axis in (s.X, s.Y):
            present = lane.P.entry(axis, axis)
            share = present / maximum(before, LEAST_VARIANCE)
            together = present / maximum(1.0 - (count - 1.0) * share, share)
            self.inflate_one(axis, select(is_sharp, maximum(together - present, 0.0), 0.0))

    def store_precision(self, verdict: _Verdict) -> None:
        """Count the fixes that were used and stated variances alike."""
        lane, variance = self.lane, self.variance
        before, count = (lane.row(name) for name in ALIKE_FIXES)
        is_alike = (variance * ALIKE_TO >= before) & (variance < ALIKE_TO * before)
        after = variance, select(is_alike, count + 1.0, 1.0)
        for row, value in zip(ALIKE_FIXES, after, strict=True):
            lane.stores[row] = select(verdict.used, value, lane.row(row))

    def follow_departure(self, S: Sequence[Real], is_off: Truth) -> tuple[Departure, Truth]:
        """Inflate the states where fixes that the gate would reject depart from the path.

        It returns the departure with this fix, and the lanes in which it is followed.
        """
        lane, considered = self.lane, self.lane.shape.considered
        departure, is_followed, errors = departure_after(
            Departure(*(lane.row(name) for name in DEPARTURE)),
            self.place,
            self.z,
            S,
            self.heading,
            lane.constant("fastest"),
            lane.constant("gauge"),
            self.interval,
        )
        departs = is_off & is_followed
        for states, error in zip(STATES, errors, strict=True):
            # A considered bias, the last state of an error, is not inflated.
            self.inflate(states[: len(states) - (states[-1] in considered)], error, departs)
        return departure, departs

    def gate(self, nis: Real) -> _Verdict:
        """Admit or reject; after some time of rejections a fix is used all the same."""
        lane = self.lane
        admitted = nis <= lane.constant("position_threshold")
        patience = patience_for(self.square, lane.constant("patience"), lane.constant("fastest"))
        is_overdue = ~admitted & (lane.row("position_rejected_for") >= patience)
        lost, reacquired = self.judged & is_overdue, self.is_forced & is_overdue
        tested = self.is_tried & ~lost
        return _Verdict(admitted, reacquired, lost, tested, tested & (admitted | reacquired))

    def store_departure(self, departure: Departure, is_off: Truth, verdict: _Verdict) -> None:
        """Store the departure that the next fix continues: none after a fix that is used."""
        lane = self.lane
        at_fix, at_path = (Departure(0.0, *place, *self.z) for place in (self.place, self.expected))
        for row, if_used, if_off, if_not in zip(DEPARTURE, at_fix, departure, at_path, strict=True):
            after = select(verdict.used | verdict.lost, if_used, select(is_off, if_off, if_not))
            lane.stores[row] = select(self.judged | verdict.used, after, lane.row(row))

    def update(self, S: Sequence[Real], verdict: _Verdict) -> None:
        """Update with both coordinates, one after the other."""
        lane, (xx, _, yy) = self.lane, S
        inflation = minimum(self.square, LARGEST_INFLATION * minimum(xx, yy))
        added = select(verdict.reacquired, inflation, 0.0)
        for axis in (s.X, s.Y):
            self.inflate_one(axis, added)
        before, considered = lane.x.copy(), lane.shape.considered
        for axis in (s.X, s.Y):
            row = self.rows[axis]
            residual = self.z[axis] - shift_of(row, lane.x, before)
            lane.update(residual, row, self.R[axis], fixed=considered, only=verdict.used)
        lane.cover_rounding(after_fix=True)
        lane.keep_inside_bounds()

    def store_factors(self, S: Sequence[Real], departs: Truth, counts: Truth) -> None:
        """Store the factors on the slip, in lanes in which the fix `counts`.

        Innovations to the same side increase them, a departure sets the largest.
        """
        lane = self.lane
        smooth = lane.input("smooth_left"), lane.input("smooth_right")
        slip, present = (select(departs, LARGEST_FACTOR, lane.row(name)) for name in FACTORS)
        trend = tuple(lane.row(name) for name in TREND)
        trend_now = trend_after(trend, *normalised(self.z, S, self.heading))
        present_now = present_factor_after(present, trend_now, *smooth)
        slip_now = slip_factor_after(slip, present_now, *smooth)
        after, before = (slip_now, present_now, *trend_now), (slip, present, *trend)
        for row, now, earlier in zip((*FACTORS, *TREND), after, before, strict=True):
            lane.stores[row] = select(counts, now, earlier)


def heading_kernel(name: str, shape: FilterShape, kind: FixKind) -> Kernel:
    """Make the kernel of a heading fix; see `Reckoning._take_fix`."""
    lane = Lane(shape, with_fast_slip=kind.fast_slip, innovations=True)
    values, rows, covariance = _predicted(lane, kind)
    unwrapped = lane.input("fix_yaw") - values[s.YAW]
    lane.gated(
        "heading",
        unwrapped - 2.0 * math.pi * trace.rounded(unwrapped * (0.5 / math.pi)),
        rows[s.YAW],
        maximum(lane.input("yaw_variance") + covariance[s.YAW][s.YAW], LEAST_VARIANCE),
        inflated=s.YAW,
        fixed=shape.considered,
        patience=lane.constant("patience"),
        interval=lane.input("heading_interval"),
    )
    lane.cover_rounding(after_fix=True)
    lane.keep_inside_bounds()
    return _finished(lane, name, (), kind)


def _predicted(lane: Lane, kind: FixKind) -> TracedPose:
    """Pose at the fix: that of the state, or a prediction if the fix lies ahead."""
    if kind.ahead:
        # The fast slip of the step before does not go on.
        before, lane.x = lane.x, lane.x.copy()
        lane.x[s.FAST_SLIP] = 0.0
        pose = Step(lane, StepKind(draws=False, moves=False, imu=False)).predict_pose()
        lane.x = before
        return pose
    rows: list[Vector] = [{axis: 1.0} for axis in range(3)]
    return TracedPose([lane.x[axis] for axis in range(3)], rows, [[0.0] * 3] * 3)


def _antenna(lane: Lane, pose: TracedPose) -> TracedPose:
    """Predicted position of the antenna and yaw, see `predictions.point_on_robot`."""
    values, (x_row, y_row, yaw_row), covariance = pose
    lean = lane.input("fix_up") * (1.0 / GRAVITY)
    forward = lane.input("fix_forward") + lean * lane.x[s.GRAVITY_X]
    left = lane.input("fix_left") + lean * lane.x[s.GRAVITY_Y]
    cos, sin = turn(values[s.YAW])
    ahead, beside = cos * forward - sin * left, sin * forward + cos * left
    rows = [combined(x_row, (-beside, yaw_row)), combined(y_row, (ahead, yaw_row)), yaw_row]
    if s.GRAVITY_X in lane.shape.states:
        by_gravity = {s.GRAVITY_X: cos, s.GRAVITY_Y: -sin}, {s.GRAVITY_X: sin, s.GRAVITY_Y: cos}
        rows[:2] = [combined(row, (lean, by)) for row, by in zip(rows[:2], by_gravity, strict=True)]
    by_pose = [{s.X: 1.0, s.YAW: -beside}, {s.Y: 1.0, s.YAW: ahead}, {s.YAW: 1.0}]
    # J C J' of the pose's covariance C, one row of J after another.
    with_pose = [[dot(by, dict(enumerate(row))) for row in covariance] for by in by_pose]
    antenna_covariance = [[dot(a, dict(enumerate(row))) for row in with_pose] for a in by_pose]
    place = [values[s.X] + ahead, values[s.Y] + beside, values[s.YAW]]
    return TracedPose(place, rows, antenna_covariance)


def _finished(lane: Lane, name: str, flags: Sequence[Truth], kind: FixKind) -> Kernel:
    """Make the kernel of a lane after a fix, with the twist if the kind has it."""
    if kind.twist:
        lane.store_twist()
    return lane.kernel(name, flags, with_fast_slip=kind.fast_slip)
