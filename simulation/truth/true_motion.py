"""True motion of a robot, and functions with which truth models make it.

All speeds and poses are in REP-103 axes: `base_link` in `odom`, starting at the origin. The truths are
`icreckon.simulation.truth.friction` (friction, the default) and `icreckon.simulation.truth.kinematic`;
`icreckon.simulation.scenario` has them by name.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.first_order import first_order
from icreckon.estimator.base.frames import compose, rotate
from icreckon.estimator.robot.robot_file import Indices, Slip, slip_components

DEFAULT_SPREAD = 0.15
# Slip residual that no index model explains; it vanishes in straight driving.
TRUE_SLIP = Slip(
    turning_x=0.01,
    turning_y=0.005,
    turning_w=0.02,
    driving_x=0.0,
    driving_y=0.0,
    driving_w=0.0,
    time_constant=1.0,
)
SAME_TIME = 1e-9  # times closer than this to a grid point are rounded to it [s]


@dataclass(frozen=True)
class TrueMotion:
    """True motion on an even grid of times, interpolated between."""

    rate: float  # grid points per second [Hz]; the first is at time zero
    poses: Floats  # (m, 3) x, y [m], yaw [rad], not wrapped
    twists: Floats  # (m, 3) v_x, v_y [m/s], w [rad/s] of base_link in its own axes
    track_speeds: Floats  # (m, 2) left, right [m/s]
    distances: Floats  # (m, 2) integrals of the track speeds since the start [m]
    parameters: Indices | None  # the true index parameters, or None if the truth has none
    source: str  # name of the truth
    gravity: Floats | None = None  # (m, 3) acceleration in base_link's axes [m/s²], None if level
    # (m,) integral of the yaw rate about base_link's own z axis [rad], on terrain; None if it is the
    # yaw of the pose. On terrain x, y are horizontal, and yaw is the heading of the projected x axis
    turns: Floats | None = None
    heights: Floats | None = None  # (m,) z of base_link above the start [m], on terrain; else None

    @property
    def end(self) -> float:
        """Time of the last grid point [s]."""
        return (len(self.poses) - 1) / self.rate

    def poses_at(self, times: Floats) -> Floats:
        """Poses (n, 3) at times (n,) [s]: arcs of the mean twist since a grid point.

        On terrain, where the twist is not in the plane of the pose, they are linear in between.
        """
        if self.turns is not None:
            return self._linear(self.poses, times)
        index, elapsed = self._locate(times)
        mean = 0.5 * (self.twists[index] + self.twists_at(times))
        return compose(self.poses[index], exponential(mean * elapsed[:, None]))

    def attitudes_at(self, times: Floats) -> Floats:
        """Roll, pitch, yaw (n, 3) [rad] of base_link in odom at times (n,) [s], as in tf."""
        poses = self.poses_at(times)
        roll_pitch = np.zeros((len(times), 2))
        if self.gravity is not None:
            forward, left, up = -self._linear(self.gravity, times).T
            roll, pitch = np.arctan2(left, up), -np.arctan2(forward, np.hypot(left, up))
            roll_pitch = np.column_stack([roll, pitch])
        return np.column_stack([roll_pitch, poses[:, 2]])

    def spatial_at(self, times: Floats) -> Floats | None:
        """Height [m], roll and pitch [rad] (n, 3) at times (n,) [s] on terrain; else None."""
        if self.heights is None:
            return None
        heights = self._linear(self.heights[:, None], times)
        return np.column_stack([heights, self.attitudes_at(times)[:, :2]])

    def turns_at(self, times: Floats) -> Floats:
        """Integral (n,) of the yaw rate about base_link's z axis [rad] at times (n,) [s]."""
        if self.turns is None:
            return np.asarray(self.poses_at(times)[:, 2])
        index, elapsed = self._locate(times)
        w = 0.5 * (self.twists[index, 2] + self.twists_at(times)[:, 2])
        return np.asarray(self.turns[index] + w * elapsed)

    def twists_at(self, times: Floats) -> Floats:
        """Twists (n, 3) at times (n,) [s], linear between grid points."""
        return self._linear(self.twists, times)

    def track_speeds_at(self, times: Floats) -> Floats:
        """Track speeds (n, 2) [m/s] at times (n,) [s], linear between grid points."""
        return self._linear(self.track_speeds, times)

    def mean_track_speeds(self, times: Floats) -> Floats:
        """Mean track speeds (n, 2) [m/s] since the previous time; the first is momentary."""
        index, elapsed = self._locate(times)
        mean = 0.5 * (self.track_speeds[index] + self.track_speeds_at(times))
        distances = self.distances[index] + mean * elapsed[:, None]
        averages = np.diff(distances, axis=0) / np.diff(times)[:, None]
        return np.concatenate([self.track_speeds_at(times[:1]), averages])

    def window(self, times: Floats, length: float) -> tuple[Floats, Floats]:
        """Start and end (n,) [s] of a window about each time, cut at the motion's ends."""
        start = np.clip(times - 0.5 * length, 0.0, self.end)
        return start, np.clip(times + 0.5 * length, 0.0, self.end)

    def accelerations_at(self, times: Floats, window: float) -> Floats:
        """Accelerations (n, 3) forward, left, dv/dt + w x v [m/s²], and dw/dt [rad/s²].

        They are means of base_link, in its own axes, over a window [s] around each time (n,) [s], so that
        they do not depend on the grid: the slip residual has no derivative at a point in time.
        """
        start, end = self.window(times, window)
        rates = (self.twists_at(end) - self.twists_at(start)) / (end - start)[:, None]
        v_x, v_y, w = self.twists_at(times).T
        rates[:, 0] -= w * v_y
        rates[:, 1] += w * v_x
        return np.asarray(rates)

    def _locate(self, times: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Index of the grid point at or before each time, and the time since [s]."""
        index = np.floor((times + SAME_TIME) * self.rate).astype(np.int64)
        index = np.clip(index, 0, len(self.poses) - 1)
        elapsed = times - index / self.rate
        return index, np.where(np.abs(elapsed) <= SAME_TIME, 0.0, elapsed)

    def _linear(self, values: Floats, times: Floats) -> Floats:
        """Values (n, k) at times (n,) [s], linear in grid values (m, k), then constant."""
        index, elapsed = self._locate(times)
        following = np.minimum(index + 1, len(values) - 1)
        share = (elapsed * self.rate)[:, None]
        return np.asarray(values[index] + share * (values[following] - values[index]))


def grid_times(duration: float, rate: float) -> Floats:
    """Times (m,) [s] of the grid points that cover a duration [s] at a rate [Hz]."""
    return np.arange(int(np.ceil((duration - SAME_TIME) * rate)) + 1) / rate


def true_motion(
    rate: float, twists: Floats, speeds: Floats, source: str, parameters: Indices | None = None
) -> TrueMotion:
    """Make a motion that starts at the origin, from grid twists (m, 3), speeds (m, 2)."""
    step = 1.0 / rate
    distances = np.zeros_like(speeds)
    distances[1:] = np.cumsum(integrals(speeds, step), axis=0)
    poses = integrate_twists(twists, step)  # from the origin
    return TrueMotion(rate, poses, twists, speeds, distances, parameters, source)


def slip_residual(
    speeds: Floats, slip: Slip, effective_gauge: float, step: float, rng: Generator
) -> Floats:
    """Slip residual (m, 3) of v_x, v_y, w [m/s, m/s, rad/s]: Gauss-Markov processes.

    `slip` has their standard deviations by the track speeds (m, 2) [m/s], and their correlation time. The
    speeds have an even step [s]; the effective gauge is L eta0 [m].
    """
    unit_variance = gauss_markov(len(speeds), step, slip.time_constant, rng)
    sigmas = slip_components(speeds[:, 0], speeds[:, 1], slip, effective_gauge)
    return np.stack(sigmas, axis=-1) * unit_variance


def gauss_markov(count: int, step: float, time_constant: float, rng: Generator) -> Floats:
    """Three independent first-order Gauss-Markov processes of unit variance.

    Of `count` samples (count, 3): x_k = a x_(k-1) + sqrt(1 - a²) n_k with a = exp(-step / time_constant)
    [s], exact at any step, stationary from the start (Gelb, Applied Optimal Estimation, section 3.6).
    """
    noise = rng.standard_normal((count, 3))
    decay = step / time_constant
    noise[1:] *= np.sqrt(-np.expm1(-2.0 * decay))
    return first_order(noise, math.exp(-decay))


def displacements(twists: Floats, step: float) -> Floats:
    """Displacements (n - 1, 3) in axes at each step's start; see `integrate_twists`."""
    motion = integrals(twists, step)
    (x_before, y_before, w_before), (x_after, y_after, w_after) = twists[:-1].T, twists[1:].T
    # The commutator of the twists at both ends.
    motion[:, 0] += step**2 / 12.0 * (w_after * y_before - w_before * y_after)
    motion[:, 1] += step**2 / 12.0 * (w_before * x_after - w_after * x_before)
    return exponential(motion)


def integrate_twists(twists: Floats, step: float) -> Floats:
    """Poses (n, 3) x, y [m], yaw [rad], not wrapped, from twists at an even step [s].

    The first is the origin. Twists (n, 3) are v_x, v_y [m/s], w [rad/s] in body axes. Each step is the
    exponential map of SE(2) of the fourth-order Magnus expansion: the integral of the twist plus the
    commutator of its two ends (Iserles et al., Lie-group methods, Acta Numerica 2000).
    """
    moves, poses = displacements(twists, step), np.zeros_like(twists)
    poses[1:, 2] = np.cumsum(moves[:, 2])
    poses[1:, :2] = np.cumsum(rotate(moves[:, :2], poses[:-1, 2]), axis=0)
    return poses


def integrals(values: Floats, step: float) -> Floats:
    """Integral (n - 1, k) over each interval of values (n, k) at an even step [s].

    Inner intervals use the cubic through four samples (fourth order), both ends the trapezoid.
    """
    integral = 0.5 * step * (values[:-1] + values[1:])
    if len(values) > 3:
        inner_sums = values[1:-2] + values[2:-1]
        integral[1:-1] = step / 24.0 * (13.0 * inner_sums - values[:-3] - values[3:])
    return integral


def exponential(motion: Floats) -> Floats:
    """Exponential map of SE(2): the pose after driving a constant twist for unit time.

    From (n, 3) twist times time to (n, 3) x, y [m], yaw [rad] (Sola et al., A micro Lie theory, eq. 156
    and 158).
    """
    x, y, yaw = motion.T
    half = 0.5 * yaw
    along = np.sinc(yaw / np.pi)
    across = np.sin(half) * np.sinc(half / np.pi)
    return np.stack([along * x - across * y, across * x + along * y, yaw], axis=-1)
