"""Sensor specifications as in data sheets, presets, and the resulting errors.

A parameter that a scenario omits (None) is taken from the preset, then from the robot file, then from
the defaults of `EncoderErrors`, `InertialErrors` or `FixErrors`: no such error, or a usual duration.
These three classes document all parameters.
"""

from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec

from icreckon.estimator.base.checks import Bound, NotNegative, Positive
from icreckon.estimator.base.errors import nearest_hint
from icreckon.estimator.robot.robot_file import Robot
from icreckon.simulation.base.errors import SimulationError
from icreckon.simulation.base.field_types import settle_types
from icreckon.simulation.sensors.encoders import DROPOUT_READINGS, EncoderErrors
from icreckon.simulation.sensors.fixes import FixErrors
from icreckon.simulation.sensors.imu import InertialErrors

# Ten dropouts in a second are a broken encoder, or a mistake.
DropoutRate = Annotated[float, Bound("from 0 to 36000", 0.0, 36_000.0)]
# Parameters that `factor` multiplies.
ENCODER_SCALED = ("speed_noise_density", "scale_sigma", "scale_difference_sigma", "resolution")
INERTIAL_SCALED = (
    "noise_density", "bias_sigma", "bias_instability", "bias_walk", "scale_sigma", "misalignment_sigma",
)  # fmt: skip
FIX_SCALED = ("sigma", "heading_sigma", "wander_sigma")
GRADED = (*INERTIAL_SCALED, "range")  # parameters of an IMU grade, in this order


class EncoderSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Encoder parameters, as in `EncoderErrors`.

    `factor` multiplies noise, scales and resolution.
    """

    speed_noise_density: NotNegative | None = None
    scale_sigma: NotNegative | None = None
    scale_difference_sigma: NotNegative | None = None
    resolution: NotNegative | None = None
    dropouts_per_hour: DropoutRate | None = None
    dropout_duration: Positive | None = None
    dropout_reads: str | None = None
    factor: NotNegative | None = None

    def __post_init__(self) -> None:
        settle_types(self)
        reads = self.dropout_reads
        if reads is not None and reads not in DROPOUT_READINGS:
            hint = nearest_hint(reads, list(DROPOUT_READINGS))
            raise SimulationError(f"dropout_reads cannot be {reads!r}{hint}")


class InertialSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gyro or accelerometer parameters, as in `InertialErrors`.

    `factor` multiplies all but time and range.
    """

    noise_density: NotNegative | None = None
    bias_sigma: NotNegative | None = None
    bias_instability: NotNegative | None = None
    bias_instability_time: Positive | None = None
    bias_walk: NotNegative | None = None
    scale_sigma: NotNegative | None = None
    misalignment_sigma: NotNegative | None = None
    range: Positive | None = None
    factor: NotNegative | None = None

    def __post_init__(self) -> None:
        settle_types(self)


class FixSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Position fix parameters, as in `FixErrors`.

    `factor` multiplies the sigmas of ordinary fixes.
    """

    sigma: NotNegative | None = None
    heading_sigma: NotNegative | None = None
    outlier_share: Annotated[float, Bound("from 0 to 1", 0.0, 1.0)] | None = None
    outlier_sigma: NotNegative | None = None
    latency: NotNegative | None = None
    wander_sigma: NotNegative | None = None
    wander_time: Positive | None = None
    factor: NotNegative | None = None

    def __post_init__(self) -> None:
        settle_types(self)


class SensorSpecs(msgspec.Struct, frozen=True, kw_only=True):
    """Specifications of all sensors."""

    encoders: EncoderSpec = EncoderSpec()
    gyro: InertialSpec = InertialSpec()
    accelerometer: InertialSpec = InertialSpec()
    fixes: FixSpec = FixSpec()


class SensorErrors(NamedTuple):
    """Errors of all sensors."""

    encoders: EncoderErrors
    gyro: InertialErrors
    accelerometer: InertialErrors
    fixes: FixErrors


def _grade(gyro: tuple[float, ...], accelerometer: tuple[float, ...]) -> SensorSpecs:
    """IMU of a grade: its parameters in the order of `GRADED`."""
    return SensorSpecs(
        gyro=InertialSpec(**dict(zip(GRADED, gyro, strict=True))),
        accelerometer=InertialSpec(**dict(zip(GRADED, accelerometer, strict=True))),
    )


# Grades are those of the IMU alone, as in data sheets; a moving vehicle adds vibration. Biases also
# walk: about as far as their instability within some ten minutes, as they do during warm-up. A grade
# lists noise density, turn-on bias, bias instability, bias walk, scale, misalignment and range, in the
# units of `InertialErrors`.
NOISE_PRESETS: dict[str, SensorSpecs] = {
    "perfect": SensorSpecs(
        encoders=EncoderSpec(speed_noise_density=0.0, scale_sigma=0.0),
        gyro=InertialSpec(noise_density=0.0, bias_sigma=0.0, bias_walk=0.0, scale_sigma=0.0),
        accelerometer=InertialSpec(noise_density=0.0, bias_sigma=0.0, bias_walk=0.0),
        fixes=FixSpec(sigma=0.0),
    ),
    "nominal": SensorSpecs(),
    # Phone and hobby MEMS (MPU-6050, MPU-9250 class): 0.01 deg/s/√Hz, 1 deg/s, 400 µg/√Hz, 50 mg; 3 %
    # of scale and 2 % across axes at most.
    "consumer": _grade(
        gyro=(1.7e-4, 1.7e-2, 5e-4, 2e-5, 0.01, 7e-3, 8.7),
        accelerometer=(4e-3, 0.5, 1e-2, 5e-4, 0.01, 7e-3, 39.0),
    ),
    # Calibrated MEMS modules (Xsens MTi, ADIS1647x class): 0.007 deg/s/√Hz, 0.2 deg/s, 10 deg/h in
    # run, 100 µg/√Hz, 5 mg, 0.05 deg of alignment.
    "industrial": _grade(
        gyro=(1.2e-4, 3.5e-3, 5e-5, 2e-6, 3e-3, 1e-3, 7.8),
        accelerometer=(1e-3, 0.05, 5e-4, 5e-5, 3e-3, 1e-3, 49.0),
    ),
    # STIM300 class: 0.15 deg/√h, 10 deg/h over temperature, 0.5 deg/h in run, 0.06 m/s/√h, 2 mg
    # over temperature, 0.05 mg in run, 500 ppm of scale, 1 mrad, 400 deg/s, 10 g.
    "tactical": _grade(
        gyro=(4.4e-5, 5e-5, 2.4e-6, 1e-7, 5e-4, 1e-3, 7.0),
        accelerometer=(1e-3, 0.02, 4.9e-4, 2e-5, 3e-4, 1e-3, 98.0),
    ),
}

Errors = TypeVar("Errors", bound=msgspec.Struct)


def noise_preset(name: str) -> SensorSpecs:
    """Sensor specifications of a preset, by its name in `NOISE_PRESETS`.

    Raises:
        SimulationError: an unknown preset; the message names the nearest.
    """
    if name not in NOISE_PRESETS:
        hint = nearest_hint(name, list(NOISE_PRESETS))
        raise SimulationError(f"no noise preset named {name!r}{hint}")
    return NOISE_PRESETS[name]


def sensor_errors(specs: SensorSpecs, noise: str, robot: Robot) -> SensorErrors:
    """Errors of all sensors from specifications, a preset (name), and the robot file."""
    preset, tracks, imu = noise_preset(noise), robot.tracks, robot.imu
    file_encoders = EncoderSpec(
        speed_noise_density=tracks.speed_noise_density, scale_sigma=tracks.scale_sigma
    )
    file_gyro = InertialSpec(
        noise_density=imu.gyro_noise_density,
        bias_sigma=imu.gyro_bias_sigma,
        bias_walk=imu.gyro_bias_walk,
        scale_sigma=imu.gyro_scale_sigma,
    )
    file_accelerometer = InertialSpec(
        noise_density=imu.accelerometer_noise_density,
        bias_sigma=imu.accelerometer_bias_sigma,
        bias_walk=imu.accelerometer_bias_walk,
    )
    imu_errors, imu_scaled = InertialErrors, INERTIAL_SCALED
    return SensorErrors(
        _combined(EncoderErrors, ENCODER_SCALED, specs.encoders, preset.encoders, file_encoders),
        _combined(imu_errors, imu_scaled, specs.gyro, preset.gyro, file_gyro),
        _combined(
            imu_errors, imu_scaled, specs.accelerometer, preset.accelerometer, file_accelerometer
        ),
        _combined(FixErrors, FIX_SCALED, specs.fixes, preset.fixes),
    )


def _combined(
    error_type: type[Errors], scaled: tuple[str, ...], *specs: EncoderSpec | InertialSpec | FixSpec
) -> Errors:
    """Errors of a sensor: each parameter by the first spec that sets it.

    The parameters named in `scaled` are multiplied by `factor`, unless they are None.
    """
    parameters: dict[str, Any] = {}
    for spec in reversed(specs):  # the first one overrides the others
        given = msgspec.structs.asdict(spec)
        parameters |= {name: value for name, value in given.items() if value is not None}
    factor = parameters.pop("factor", 1.0)
    errors = error_type(**parameters)
    sizes = {name: getattr(errors, name) for name in scaled}
    multiplied = {name: factor * size for name, size in sizes.items() if size is not None}
    return msgspec.structs.replace(errors, **multiplied)
