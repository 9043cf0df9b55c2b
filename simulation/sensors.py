"""Sensor models: what encoders, IMU and position fixes read of a true motion.

Noise is given as a density (per root second), so a sensor sampled twice as often has noise that is
larger by the root of two in each sample and the same in what its samples add up to. Every sensor
draws all of its random numbers whatever its noise, so that changing one figure changes no other
error.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from estimator.errors import nearest_hint
from estimator.kinematics import GRAVITY
from estimator.log import FixSeries, ImuSeries, TrackSpeedSeries
from estimator.robot import Robot
from simulation.errors import SimulationError
from simulation.truth import TrueMotion

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

EPOCH = 1_700_000_000_000_000_000
STANDING = 1e-9
# A fix without error still says that it is good to a millimetre (a milliradian): a log has no room
# for a variance of zero.
SMALLEST_FIX_SIGMA = 1e-3


class SensorNoise(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise of all sensors; a figure left out (None) is the robot file's.

    Attributes:
        speed_noise_density: white noise of each track's speed [m/s/√Hz].
        track_scale_sigma: of the unknown part of the effective sprocket radius, both tracks alike
            [-].
        gyro_noise_density: [rad/s/√Hz].
        gyro_bias_sigma: standard deviation of each axis' bias at the start [rad/s].
        gyro_bias_walk: random walk of the bias [rad/s/√s].
        accelerometer_noise_density: [m/s²/√Hz].
        accelerometer_bias_sigma: [m/s²].
        accelerometer_bias_walk: [m/s²/√s].
        tracks_factor: on all figures of the tracks [-].
        gyro_factor: on all figures of the gyro [-].
        accelerometer_factor: on all figures of the accelerometer [-].
        fix_factor: on the standard deviations of fixes [-].
    """

    speed_noise_density: float | None = None
    track_scale_sigma: float | None = None
    gyro_noise_density: float | None = None
    gyro_bias_sigma: float | None = None
    gyro_bias_walk: float | None = None
    accelerometer_noise_density: float | None = None
    accelerometer_bias_sigma: float | None = None
    accelerometer_bias_walk: float | None = None
    tracks_factor: float = 1.0
    gyro_factor: float = 1.0
    accelerometer_factor: float = 1.0
    fix_factor: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0.0):
                raise SimulationError(f"{name} must be zero or a positive number, found {value!r}")


# Figures of the gyro and accelerometer alone, as in data sheets; a moving vehicle adds vibration.
# Bias walks are chosen so that a bias moves by about its in-run stability within some ten minutes.
NOISE_PRESETS: dict[str, SensorNoise] = {
    "perfect": SensorNoise(
        tracks_factor=0.0, gyro_factor=0.0, accelerometer_factor=0.0, fix_factor=0.0
    ),
    "nominal": SensorNoise(),
    # Phone and hobby MEMS (MPU-6050, MPU-9250 class): 0.01 deg/s/√Hz, 1 deg/s, 400 µg/√Hz, 50 mg.
    "consumer": SensorNoise(
        gyro_noise_density=1.7e-4,
        gyro_bias_sigma=1.7e-2,
        gyro_bias_walk=2e-5,
        accelerometer_noise_density=4e-3,
        accelerometer_bias_sigma=0.5,
        accelerometer_bias_walk=5e-4,
    ),
    # Calibrated MEMS modules (Xsens MTi, ADIS1647x class): 0.007 deg/s/√Hz, 0.2 deg/s, 10 deg/h in
    # run, 100 µg/√Hz, 5 mg.
    "industrial": SensorNoise(
        gyro_noise_density=1.2e-4,
        gyro_bias_sigma=3.5e-3,
        gyro_bias_walk=2e-6,
        accelerometer_noise_density=1e-3,
        accelerometer_bias_sigma=0.05,
        accelerometer_bias_walk=5e-5,
    ),
    # STIM300 class: 0.15 deg/√h, 10 deg/h over temperature, 0.5 deg/h in run, 0.06 m/s/√h, 2 mg
    # over temperature, 0.05 mg in run.
    "tactical": SensorNoise(
        gyro_noise_density=4.4e-5,
        gyro_bias_sigma=5e-5,
        gyro_bias_walk=1e-7,
        accelerometer_noise_density=1e-3,
        accelerometer_bias_sigma=0.02,
        accelerometer_bias_walk=2e-5,
    ),
}


class TrackNoise(msgspec.Struct, frozen=True):
    """Noise of the track speeds: white density [m/s/√Hz] and sigma of the scale [-]."""

    density: float
    scale_sigma: float


class InertialNoise(msgspec.Struct, frozen=True):
    """Noise of a gyro or accelerometer: white density, sigma and random walk of the bias."""

    density: float
    bias_sigma: float
    bias_walk: float


@dataclass(frozen=True)
class Imu:
    """What the IMU reads, and the part of it that is bias.

    Attributes:
        series: the samples.
        gyro_bias: (n, 3) in the IMU's axes [rad/s].
        accelerometer_bias: (n, 3) in the IMU's axes [m/s²].
    """

    series: ImuSeries
    gyro_bias: Floats
    accelerometer_bias: Floats


def noise_preset(name: str, overrides: dict[str, float] | None = None) -> SensorNoise:
    """The sensor noise of a preset, with some figures replaced.

    Args:
        name: one of `NOISE_PRESETS`.
        overrides: field of `SensorNoise` -> value.

    Raises:
        SimulationError: an unknown preset or field (says which is nearest), or a negative value.
    """
    if name not in NOISE_PRESETS:
        hint = nearest_hint(name, list(NOISE_PRESETS))
        raise SimulationError(f"no noise preset named {name!r}{hint}")
    fields = list(SensorNoise.__struct_fields__)
    for field in overrides or {}:
        if field not in fields:
            raise SimulationError(f"no noise figure named {field!r}{nearest_hint(field, fields)}")
    return msgspec.structs.replace(NOISE_PRESETS[name], **(overrides or {}))


def track_noise(noise: SensorNoise, robot: Robot) -> TrackNoise:
    """Noise of the track speeds, with the robot file's figures where `noise` leaves them out."""
    tracks, factor = robot.tracks, noise.tracks_factor
    return TrackNoise(
        factor * _given(noise.speed_noise_density, tracks.speed_noise_density),
        factor * _given(noise.track_scale_sigma, tracks.scale_sigma),
    )


def gyro_noise(noise: SensorNoise, robot: Robot) -> InertialNoise:
    """Noise of the gyro, with the robot file's figures where `noise` leaves them out."""
    imu, factor = robot.imu, noise.gyro_factor
    return InertialNoise(
        factor * _given(noise.gyro_noise_density, imu.gyro_noise_density),
        factor * _given(noise.gyro_bias_sigma, imu.gyro_bias_sigma),
        factor * _given(noise.gyro_bias_walk, imu.gyro_bias_walk),
    )


def accelerometer_noise(noise: SensorNoise, robot: Robot) -> InertialNoise:
    """Noise of the accelerometer, with the robot file's figures where `noise` leaves them out."""
    imu, factor = robot.imu, noise.accelerometer_factor
    return InertialNoise(
        factor * _given(noise.accelerometer_noise_density, imu.accelerometer_noise_density),
        factor * _given(noise.accelerometer_bias_sigma, imu.accelerometer_bias_sigma),
        factor * _given(noise.accelerometer_bias_walk, imu.accelerometer_bias_walk),
    )


def sample_times(duration: float, rate: float) -> Floats:
    """Times (n,) [s] from zero to duration, both included where the rate allows."""
    return np.asarray(np.arange(int(np.floor(duration * rate + 1e-6)) + 1) / rate)


def to_stamps(times: Floats) -> Stamps:
    """Stamps (n,) [ns] of times (n,) [s] since the start of the run, which is at `EPOCH`."""
    return EPOCH + np.rint(times * 1e9).astype(np.int64)


def read_tracks(
    motion: TrueMotion, times: Floats, rate: float, noise: TrackNoise, rng: Generator
) -> TrackSpeedSeries:
    """Track speeds from encoders: averages since the sample before; no noise on a standing track.

    Args:
        motion: the true motion.
        times: (n,) when to sample [s].
        rate: samples per second [Hz], which turns density into noise per sample.
        noise: of the track speeds.
        rng: draws the errors.
    """
    scale = 1.0 + noise.scale_sigma * rng.standard_normal()
    true = motion.mean_track_speeds(times)
    errors = noise.density * np.sqrt(rate) * rng.standard_normal(true.shape)
    speeds = true / scale + np.where(np.abs(true) > STANDING, errors, 0.0)
    return TrackSpeedSeries(to_stamps(times), speeds)


def read_imu(
    motion: TrueMotion,
    times: Floats,
    rate: float,
    robot: Robot,
    gyro: InertialNoise,
    accelerometer: InertialNoise,
    gyro_rng: Generator,
    accelerometer_rng: Generator,
) -> Imu:
    """IMU samples in the IMU's axes, at its place and mounting in the robot file.

    The accelerometer reads specific force, averaged over one sample interval; gravity is `GRAVITY`.
    The gyro reads `gyro_scale` times the rate, and of "z" gyros x and y are zero.

    Args:
        motion: the true motion.
        times: (n,) when to sample [s].
        rate: samples per second [Hz].
        robot: place, mounting, axes and scale of the IMU.
        gyro: noise of the gyro.
        accelerometer: noise of the accelerometer.
        gyro_rng: draws the errors of the gyro.
        accelerometer_rng: draws the errors of the accelerometer.
    """
    # Rows times a matrix: v^T R is (R^T v)^T, from base_link to the IMU's axes.
    to_imu = robot.imu_rotation
    w = motion.twists_at(times)[:, 2]
    rates = np.stack([np.zeros_like(w), np.zeros_like(w), w], axis=-1) @ to_imu
    forces = specific_forces(motion, times, 1.0 / rate, robot.imu.position) @ to_imu
    gyro_errors, gyro_bias = _inertial_errors(len(times), rate, gyro, gyro_rng)
    force_errors, force_bias = _inertial_errors(len(times), rate, accelerometer, accelerometer_rng)
    angular_velocity = robot.imu.gyro_scale * rates + gyro_errors + gyro_bias
    if robot.imu.gyro_axes == "z":
        angular_velocity[:, :2] = 0.0
    series = ImuSeries(to_stamps(times), angular_velocity, forces + force_errors + force_bias)
    return Imu(series, gyro_bias, force_bias)


def specific_forces(
    motion: TrueMotion, times: Floats, window: float, position: tuple[float, float, float]
) -> Floats:
    """Specific force (n, 3) in base_link's axes at a place fixed to it [m/s²].

    Acceleration of base_link plus dw/dt x r + w x (w x r), less the acceleration of gravity.

    Args:
        motion: the true motion.
        times: (n,) [s].
        window: over which accelerations are averaged [s].
        position: r, the place in base_link [m].
    """
    a_x, a_y, w_rate = motion.accelerations_at(times, window).T
    w = motion.twists_at(times)[:, 2]
    r_x, r_y, _ = position
    return np.stack(
        [
            a_x - w_rate * r_y - w**2 * r_x,
            a_y + w_rate * r_x - w**2 * r_y,
            np.full_like(w, GRAVITY),
        ],
        axis=-1,
    )


def read_fixes(
    motion: TrueMotion,
    times: Floats,
    sigma: float,
    heading_sigma: float | None,
    factor: float,
    outages: tuple[tuple[float, float], ...],
    rng: Generator,
) -> FixSeries:
    """Position fixes, with heading where `heading_sigma` is given, and none in an outage.

    Args:
        motion: the true motion.
        times: (n,) when to sample [s].
        sigma: standard deviation of each coordinate [m].
        heading_sigma: of yaw [rad], or None for fixes without heading.
        factor: on both.
        outages: start and end [s] of each time without fixes, both included.
        rng: draws the errors, those of fixes lost in an outage included.
    """
    poses = motion.poses_at(times)
    heading = 0.0 if heading_sigma is None else heading_sigma
    sigmas = factor * np.array([sigma, sigma, heading])
    poses = poses + sigmas * rng.standard_normal(poses.shape)
    if heading_sigma is None:
        poses[:, 2] = np.nan
    stated = np.maximum(sigmas[1:], SMALLEST_FIX_SIGMA) ** 2
    seen = np.ones(len(times), dtype=bool)
    for start, end in outages:
        seen &= (times < start) | (times > end)
    stamps = to_stamps(times)[seen]
    return FixSeries(stamps, poses[seen], np.tile(stated, (len(stamps), 1)))


def _inertial_errors(
    count: int, rate: float, noise: InertialNoise, rng: Generator
) -> tuple[Floats, Floats]:
    """White noise (count, 3) and bias (count, 3) with its random walk."""
    start = noise.bias_sigma * rng.standard_normal(3)
    white, walk = np.moveaxis(rng.standard_normal((count, 2, 3)), 1, 0)
    walk[0] = 0.0
    bias = start + np.cumsum(noise.bias_walk / np.sqrt(rate) * walk, axis=0)
    return noise.density * np.sqrt(rate) * white, bias


def _given(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
