"""Time series of each sensor, the truth, and integrals of samples."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from icreckon.estimator.base.array_types import NANOSECOND, Floats, Stamps
from icreckon.estimator.base.checks import require_kind, require_nanoseconds
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import rpy_to_quaternion

AnySeries = TypeVar(
    "AnySeries", bound="TrackSpeedSeries | ImuSeries | PoseSeries | TwistSeries | FixSeries"
)


class OneLine:
    """Series that are shown on one line."""

    stamps: Stamps

    def __repr__(self) -> str:
        """Type and number of samples."""
        return f"<{type(self).__name__} of {len(self.stamps)} samples>"


@dataclass(frozen=True, repr=False)
class TrackSpeedSeries(OneLine):
    """Track speeds.

    `stamps` (n,) [ns]; `speeds` (n, 2) left, right [m/s], forward positive; `left_wheels` (n, k) and
    `right_wheels` (n, m): speeds of the wheels of each side [m/s], or both None if they are not known, or
    never disagree.
    """

    stamps: Stamps
    speeds: Floats
    left_wheels: Floats | None = None
    right_wheels: Floats | None = None

    def __post_init__(self) -> None:
        _check_values(self, "speeds", (2,))
        for name in ("left_wheels", "right_wheels"):
            # Any number of wheels, but a row of them for each stamp.
            _check_values(self, name, np.shape(getattr(self, name))[1:2] or (1,))
        if (self.left_wheels is None) != (self.right_wheels is None):
            raise EstimatorError("left_wheels and right_wheels go together, found one of them")

    @property
    def difference(self) -> Floats:
        """Speed of the right track less that of the left (n,) [m/s]: V_r - V_l."""
        left, right = self.speeds.T
        return np.asarray(right - left)


@dataclass(frozen=True, repr=False)
class ImuSeries(OneLine):
    """IMU samples in the IMU's own axes.

    `stamps` (n,) [ns]; `angular_velocity` (n, 3) [rad/s]; `linear_acceleration` (n, 3) [m/s²],
    specific force, a row NaN if a sample has none, or None if the IMU has no accelerometer.
    """

    stamps: Stamps
    angular_velocity: Floats
    linear_acceleration: Floats | None = None

    def __post_init__(self) -> None:
        _check_values(self, "angular_velocity", (3,))
        _check_values(self, "linear_acceleration", (3,))


@dataclass(frozen=True, repr=False)
class PoseSeries(OneLine):
    """Poses: planar ones, and the rest of them in three dimensions if it is known.

    `stamps` (n,) [ns]; `poses` (n, 3) x, y [m], yaw [rad] (unwrapped or not); `spatial` (n, 3) z [m],
    roll, pitch [rad] (fixed axes, as in tf), or None; `travelled` (n,) distance [m] by another source,
    None for that along the positions.
    """

    stamps: Stamps
    poses: Floats
    spatial: Floats | None = None
    travelled: Floats | None = None

    def __post_init__(self) -> None:
        _check_values(self, "poses", (3,))
        _check_values(self, "spatial", (3,))
        _check_values(self, "travelled", ())

    @property
    def positions(self) -> Floats:
        """(n, 3) x, y, z [m]; z is zero for planar poses."""
        heights = np.zeros(len(self.stamps)) if self.spatial is None else self.spatial[:, 0]
        return np.column_stack([self.poses[:, :2], heights])

    @property
    def quaternions(self) -> Floats:
        """(n, 4) attitudes in ROS order x, y, z, w."""
        tilt = np.zeros((len(self.stamps), 2)) if self.spatial is None else self.spatial[:, 1:]
        return rpy_to_quaternion(tilt[:, 0], tilt[:, 1], self.poses[:, 2])

    def rows(self, which: Any) -> PoseSeries:
        """Poses of the rows that an index, a mask or a slice selects."""
        return rows_of(self, which)


@dataclass(frozen=True, repr=False)
class TwistSeries(OneLine):
    """Body velocities of `base_link`.

    `stamps` (n,) [ns]; `twists` (n, 3) v_x, v_y [m/s], w [rad/s].
    """

    stamps: Stamps
    twists: Floats

    def __post_init__(self) -> None:
        _check_values(self, "twists", (3,))


@dataclass(frozen=True, repr=False)
class FixSeries(OneLine):
    """Position or pose fixes in `odom`.

    `stamps` (n,) [ns]; `poses` (n, 3) x, y [m], yaw [rad], yaw NaN if a fix has no heading;
    `variances` (n, 2): of each coordinate [m²] and of yaw [rad²] (ignored if yaw is NaN);
    `antennas` (n, 3): measured point in `base_link`, forward, left and up [m], None for its origin.
    """

    stamps: Stamps
    poses: Floats
    variances: Floats
    antennas: Floats | None = None

    def __post_init__(self) -> None:
        _check_values(self, "poses", (3,))
        _check_values(self, "variances", (2,))
        _check_values(self, "antennas", (3,))

    @property
    def lever_arms(self) -> Floats:
        """Measured points in `base_link` (n, 3), forward, left and up [m]."""
        return np.zeros((len(self.stamps), 3)) if self.antennas is None else self.antennas


@dataclass(frozen=True)
class Truth:
    """Ground truth, as far as it is known.

    Attributes:
        poses: the pose of the robot.
        twists: its body velocity, or None.
        tracks: its track speeds without sensor error, or None.
        source: origin of the truth ("kinematic", "lidar map", ...).
        headings: False if it shows positions alone; the yaw of `poses` is NaN then, or from the path.
    """

    poses: PoseSeries
    twists: TwistSeries | None = None
    tracks: TrackSpeedSeries | None = None
    source: str = "unknown"
    headings: bool = True

    def __post_init__(self) -> None:
        require_part("poses", self.poses, PoseSeries)
        require_part("twists", self.twists, TwistSeries, or_none=True)
        require_part("tracks", self.tracks, TrackSpeedSeries, or_none=True)

    def positions_alone(self) -> Truth:
        """Truth without headings, nor the twists and track speeds that would show them."""
        poses = self.poses.poses.copy()
        poses[:, 2] = np.nan
        known = replace(self.poses, poses=poses)
        return replace(self, poses=known, twists=None, tracks=None, headings=False)


def rows_of(series: AnySeries, which: Any) -> AnySeries:
    """Series of the rows that an index, a mask or a slice selects."""
    arrays: dict[str, Any] = vars(series)
    selected = {name: array[which] for name, array in arrays.items() if array is not None}
    return replace(series, **selected)


def running_integral(stamps: Stamps, values: NDArray[Any]) -> NDArray[Any]:
    """Integrate samples (n, ...), which change steadily in between, up to each one.

    scipy's `cumulative_trapezoid` is the same, and takes 0.7 s to load. Stamps are in ns, integrals in
    the samples' unit times seconds; zero at the first.
    """
    seconds = (np.diff(stamps) * NANOSECOND).reshape(-1, *[1] * (values.ndim - 1))
    steps = np.zeros(values.shape, np.result_type(values, float))
    steps[1:] = 0.5 * seconds * (values[1:] + values[:-1])
    return np.cumsum(steps, axis=0, out=steps)


def require_part(name: str, value: object, kind: type, *, or_none: bool = False) -> None:
    """Reject a part of a log of another type, such as an array in place of a series."""
    require_kind(name, value, kind, or_none=or_none, shown=False)


def _check_values(series: Any, name: str, width: tuple[int, ...]) -> None:
    """Check stamps (n,) and values (n, *width), which become floats; None is allowed."""
    stamps, values = series.stamps, getattr(series, name)
    if values is None:
        return
    for field, array in (("stamps", stamps), (name, values)):
        if not isinstance(array, np.ndarray):
            raise EstimatorError(
                f"{field} must be a numpy array, found {type(array).__name__}; use numpy.asarray"
            )
    if stamps.dtype.kind not in "iu":
        raise EstimatorError(
            f"stamps must be integers [ns], found {stamps.dtype}; of seconds they are "
            "numpy.round(seconds * 1e9).astype(numpy.int64)"
        )
    if len(stamps):
        require_nanoseconds(int(stamps.min()), int(stamps.max()), len(stamps))
        if (stamps[1:] < stamps[:-1]).any():
            raise EstimatorError(
                f"stamps of {name} go back; sort the rows by numpy.argsort(stamps), or cut them there"
            )
    if values.shape != (len(stamps), *width):
        raise EstimatorError(
            f"{name} must have shape {(len(stamps), *width)} to go with {len(stamps)} stamps, "
            f"found {values.shape}"
        )
    if values.dtype.kind not in "fiu":
        raise EstimatorError(f"{name} must be numbers, found {values.dtype}")
    # The filters are compiled for these, also where a driver gives single precision or integers.
    object.__setattr__(series, name, values.astype(float, copy=False))
