"""Measurement models: for each sensor a class that returns z, H and R.

`MODELS` is the table of sensors. The filter updates with any of them in the same way: predict a pose or
a twist, linearise, gate, update, record. `register` adds a sensor that is no part of the package.
"""

from contextlib import suppress
from typing import Any, ClassVar, Generic, Literal, NamedTuple, TypeVar, get_args

import numpy as np

from icreckon.estimator.base import state as s
from icreckon.estimator.base.array_types import Floats
from icreckon.estimator.base.errors import EstimatorError
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.log.input_checks import add_stream, remove_stream
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    HeightFix,
    Measurement,
    PoseFix,
    PositionFix,
    ZeroVelocity,
)
from icreckon.estimator.sensors.predictions import Prediction as Prediction  # for sensors of others

# Gates have thresholds for up to this many components (`icreckon.estimator.filter.gate.CHI_SQUARE_1E4`).
MOST_COMPONENTS = 3
# A twist measurement does not move pose and height, which are to be continuous.
POSE_FIXED = (s.X, s.Y, s.YAW, s.Z)
# A zero velocity moves only the slip: it differs from the slip before the stop, and the difference would
# be attributed to biases and parameters.
STANDING_FIXED = (*POSE_FIXED, *range(s.LEARNT.start, s.LEARNT.stop), s.GRAVITY_X, s.GRAVITY_Y)
# A height moves the height, the slope, and the biases that are correlated with the slope.
WITH_HEIGHT = (s.Z, *range(s.ACCELEROMETER_BIAS_X, s.GYRO_BIAS_Y + 1), s.GRAVITY_X, s.GRAVITY_Y)

# Names of the accelerometers, forward and left, and of all sensors of the IMU.
ACCELEROMETERS = ("accelerometer_x", "accelerometer_y")
IMU_SENSORS = ("gyro", *ACCELEROMETERS)

M = TypeVar("M", bound=Measurement)
Quantity = Literal["pose", "twist", "height"]


def imu_fixed(updated_parameters: tuple[int, ...]) -> tuple[int, ...]:
    """States that the IMU does not move: pose, scales, parameters not at these places.

    The IMU would attribute other errors of the motion to them: against tracks that slip in gentle bends,
    the scale of a healthy gyro went 6 % wrong. Fixes and body velocities measure them.
    """
    moved = (s.PARAMETERS.start + place for place in updated_parameters)
    parameters = set(range(s.PARAMETERS.start, s.PARAMETERS.stop)).difference(moved)
    return (*POSE_FIXED, *sorted(parameters), s.TRACK_SCALE, s.GYRO_SCALE)


def gyro_fixed(updated_parameters: tuple[int, ...]) -> tuple[int, ...]:
    """States that neither the gyro nor a standstill moves; argument as in `imu_fixed`.

    To the states of `imu_fixed` it adds gravity along the ground, and the biases that are correlated with
    it: of the accelerometers and of the rates of roll and pitch. Gyro and standstill measure a slope only
    by the slip that the model predicts on it: errors of the model would be taken for slopes.
    """
    biases = range(s.ACCELEROMETER_BIASES.start, s.GYRO_BIAS_Y + 1)
    return (*imu_fixed(updated_parameters), *biases, s.GRAVITY_X, s.GRAVITY_Y)


class Linearised(NamedTuple):
    """Measurement linearised at a state."""

    z: Floats  # (n,) innovation: measured less predicted
    H: Floats  # (n, SIZE) Jacobian of the predicted measurement
    R: Floats  # (n, n) covariance of the measurement noise


def checked(name: str, count: int, states: int, linearised: Any) -> Linearised:
    """Check a linearised measurement of a sensor, and convert it to arrays.

    Raises:
        EstimatorError: a part is not numeric, has a shape that does not fit `count` components and
            `states` states, or R has a negative variance; the message has the sensor's `name`.
    """
    wanted, shapes = ((count,), (count, states), (count, count)), ""
    with suppress(TypeError, ValueError):
        z, H, R = (np.asarray(part, dtype=float) for part in linearised)
        found = z.shape, H.shape, R.shape
        shapes = f", found {found}"
        if found == wanted:
            if not (R.diagonal() < 0.0).any():
                return Linearised(z, H, R)
            shapes = f", and variances in R: found {R.tolist()}"
    raise EstimatorError(f"{name}: linearise must return z, H and R of shapes {wanted}{shapes}")


class MeasurementModel:
    """Properties of a sensor that its updates depend on, see `FixModel`."""

    name: str  # name of the sensor in health, checkpoints and the order of streams
    components: tuple[str, ...]  # names of the components of its innovation
    inflated: tuple[int, ...]
    inflated_jointly: ClassVar[bool] = False  # each by the innovations of all components
    fixed: tuple[int, ...] = ()
    is_place: ClassVar[bool] = False
    correlated: ClassVar[bool] = True


class FixModel(MeasurementModel, Generic[M]):
    """Sensor that measures the pose or the twist, apart from tracks and IMU.

    Attributes:
        predicts: what `linearise` takes: "pose" (x, y, yaw in odom), "twist" (v_x, v_y, w) or "height".
        inflated: a state for each component, which becomes uncertain where readings are re-acquired.
        fixed: states that updates do not move.
        is_place: the first two components are a position [m]; lasting slip is inflated before the gate.
        correlated: updates use the correlations of R; otherwise only the gate does.
        standing: the robot stands while it is measured.
    """

    predicts: ClassVar[Quantity]
    standing: ClassVar[bool] = False

    def linearise(self, measurement: M, predicted: Prediction) -> Linearised:
        """Compare a measurement with its prediction, a pose, twist or height."""
        raise NotImplementedError


class Position(FixModel[PositionFix]):
    """Position of an antenna in odom; updates are those of `Reckoning._take_position`."""

    name, predicts = "position", "pose"
    components = ("position_x", "position_y")
    inflated, inflated_jointly, is_place = (s.X, s.Y), True, True


class Heading(FixModel[HeadingFix]):
    """Yaw of base_link in odom."""

    name, predicts = "heading", "pose"
    components = ("heading",)
    inflated = (s.YAW,)

    def linearise(self, measurement: HeadingFix, predicted: Prediction) -> Linearised:
        """Compare the yaw with the predicted pose."""
        z = np.array([wrap_angle(measurement.yaw - predicted.values.item(2))])
        return Linearised(z, predicted.H[2:], predicted.R[2:, 2:] + measurement.variance)


class Height(FixModel[HeightFix]):
    """Height of base_link in odom."""

    name, predicts = "height", "height"
    components = ("height",)
    inflated = (s.Z,)
    fixed = tuple(i for i in range(s.SIZE) if i not in WITH_HEIGHT)

    def linearise(self, measurement: HeightFix, predicted: Prediction) -> Linearised:
        """Compare the height with the predicted one."""
        R = predicted.R + measurement.variance
        return Linearised(measurement.z - predicted.values, predicted.H, R)


class BodyTwist(FixModel[BodyVelocity]):
    """Velocity of base_link, forward and to the left."""

    name, predicts = "body velocity", "twist"
    components = ("body_velocity_x", "body_velocity_y")
    inflated, inflated_jointly = (s.SLIP_X, s.SLIP_Y), True
    fixed = POSE_FIXED
    correlated = False

    def linearise(self, measurement: BodyVelocity, predicted: Prediction) -> Linearised:
        """Compare v_x and v_y with the predicted twist."""
        z = np.array((measurement.v_x, measurement.v_y)) - predicted.values[:2]
        R = predicted.R[:2, :2] + measurement.variance * np.eye(2)
        return Linearised(z, predicted.H[:2], R)


class Pose(FixModel[PoseFix]):
    """Pose of base_link in odom."""

    name, predicts = "pose", "pose"
    components = ("pose_x", "pose_y", "pose_yaw")
    inflated, is_place = (s.X, s.Y, s.YAW), True

    def linearise(self, measurement: PoseFix, predicted: Prediction) -> Linearised:
        """Compare the pose with its prediction."""
        z = np.array((measurement.x, measurement.y, measurement.yaw)) - predicted.values
        z[2] = wrap_angle(z[2])
        covariance = np.array(measurement.covariance)
        return Linearised(z, predicted.H, predicted.R + (0.5 * covariance + 0.5 * covariance.T))


class Standing(FixModel[ZeroVelocity]):
    """Zero velocity of a robot that stands."""

    name, predicts = "zero velocity", "twist"
    components = ("zero_velocity_x", "zero_velocity_y", "zero_velocity_w")
    inflated = (s.SLIP_X, s.SLIP_Y, s.SLIP_W)
    fixed = STANDING_FIXED
    standing = True

    def linearise(self, measurement: ZeroVelocity, predicted: Prediction) -> Linearised:
        """Compare zero with the predicted twist."""
        R = predicted.R + np.diag(np.square(measurement.sigma))
        return Linearised(-predicted.values, predicted.H, R)


# Sensors by type of measurement; tracks and IMU have steps of their own in the filter.
MODELS: dict[type[Measurement], FixModel[Any]] = {
    PositionFix: Position(),
    HeadingFix: Heading(),
    BodyVelocity: BodyTwist(),
    PoseFix: Pose(),
    ZeroVelocity: Standing(),
    HeightFix: Height(),
}


def register(kind: type[M], model: FixModel[M]) -> None:
    """Add a sensor; estimators that are made afterwards take its measurements.

    Args:
        kind: type of its measurements: a frozen dataclass or msgspec struct with `stamp` [ns] first and
            floats, triples or (3, 3) tuples after it. Fields named `variance`, `sigma` and `covariance`
            are noise and must be positive; all others must be finite.
        model: its measurement model.

    Raises:
        EstimatorError: the type or the name is taken, the first field is not `stamp`, the model
            inflates another number of states than it has components, has more than `MOST_COMPONENTS`,
            or predicts no `Quantity`.
    """
    if not isinstance(model, FixModel):
        raise EstimatorError(f"{kind.__name__}: a FixModel() is needed, found {model!r}")
    known, count, inflated = get_args(Quantity), len(model.components), model.inflated
    states = set(range(s.SIZE))
    for is_right, problem in (
        (model.predicts in known, f"predicts must be one of {known}, found {model.predicts!r}"),
        (len(inflated) == count, "one inflated state for each component is needed"),
        (set(inflated) <= states, f"inflated states are 0 to {s.SIZE - 1}, found {inflated!r}"),
        (1 <= count <= MOST_COMPONENTS, f"{count} components, not 1 to {MOST_COMPONENTS}"),
        (model.name not in IMU_SENSORS, "there is such a sensor already"),
    ):
        if not is_right:
            raise EstimatorError(f"{model.name}: {problem}")
    add_stream(kind, model.name)
    MODELS[kind] = model


def unregister(kind: type[Measurement]) -> None:
    """Remove a sensor that `register` added, and that no estimator takes any more."""
    del MODELS[kind]
    remove_stream(kind)


def innovation_components() -> dict[str, tuple[str, ...]]:
    """Names of the innovation's components, by sensor; the IMU's sensors come first."""
    imu_components = {name: (name,) for name in IMU_SENSORS}
    return imu_components | {model.name: model.components for model in MODELS.values()}
