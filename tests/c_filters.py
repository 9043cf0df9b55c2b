"""Exported filters, compiled for this machine, and side by side with the estimator in Python."""

import ctypes
import math
import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from icreckon import PoseEstimator, Robot, Settings
from icreckon.estimator.base import state as s
from icreckon.estimator.embedded.c_filter import filter_in_c
from icreckon.estimator.log.input_checks import RANKS
from icreckon.estimator.log.measurements import (
    BodyVelocity,
    HeadingFix,
    ImuSample,
    Measurement,
    PositionFix,
    TrackSpeeds,
    ZeroVelocity,
)
from icreckon.estimator.robot.variants import find_variant

IMU_RATE = 200.0
USED, LEARNT = 0, range(s.LEARNT.start, s.LEARNT.stop)
# Standard deviations below these are what is left of larger numbers that cancel.
LEAST_SIGMA = 1e-9


def compiler(name: str = "gcc") -> str:
    """A compiler, or a visible skip without it."""
    if shutil.which(name) is None:
        pytest.skip(f"no {name} here: install it to compile exported filters")
    return name


def compiled(source: str, folder: Path, *flags: str, cc: str = "gcc") -> ctypes.CDLL:
    """Library of a C source."""
    number = len(list(folder.glob("*.c")))
    path, shared = folder / f"source{number}.c", folder / f"library{number}.so"
    path.write_text(source, encoding="utf-8")
    command = [compiler(cc), "-std=c99", "-ffp-contract=off", *(flags or ("-O0",))]
    command += ["-shared", "-fPIC", f"-I{folder}", str(path), "-o", str(shared), "-lm"]
    subprocess.run(command, check=True, timeout=300)
    return ctypes.CDLL(str(shared))


@cache
def _library(
    robot: bytes, variant: str, settings: bytes, bits: int, flags: tuple[str, ...], cc: str
) -> tuple[ctypes.CDLL, list[int]]:
    decoded = msgspec.json.decode(robot, type=Robot)
    exported = filter_in_c(
        decoded,
        find_variant(variant),
        msgspec.json.decode(settings, type=Settings),
        bits=bits,
        imu_rate=IMU_RATE,
    )
    with tempfile.TemporaryDirectory(prefix="icreckon-filter-") as name:
        folder = Path(name)
        header = exported.files["icreckon_filter.h"]
        (folder / "icreckon_filter.h").write_text(header, encoding="utf-8")
        library = compiled(exported.files["icreckon_filter.c"], folder, *flags, cc=cc)
    return library, exported.states


class CFilter:
    """Filter in C, with the words of its header.

    Args:
        robot: the robot.
        variant: name of the variant.
        settings: settings of the filter.
        bits: bits of a number.
        flags: of the compiler.
        cc: the compiler.
    """

    def __init__(
        self,
        robot: Robot,
        variant: str,
        settings: Settings | None = None,
        *,
        bits: int = 64,
        flags: tuple[str, ...] = ("-O0",),
        cc: str = "gcc",
    ) -> None:
        real: Any = ctypes.c_double if bits == 64 else ctypes.c_float
        self.real, self.three = real, real * 3
        key = msgspec.json.encode(robot), variant, msgspec.json.encode(settings or Settings())
        self.lib, self.states = _library(*key, bits, flags, cc)

        class Pose(ctypes.Structure):
            _fields_ = (
                ("stamp", ctypes.c_int64),
                ("x", real),
                ("y", real),
                ("yaw", real),
                ("covariance", real * 9),
            )

        class Twist(ctypes.Structure):
            _fields_ = (("v_x", real), ("v_y", real), ("w", real), ("covariance", real * 9))

        class Icrs(ctypes.Structure):
            _fields_ = (("x", real), ("left_y", real), ("right_y", real))

        lib, stamp, at = self.lib, ctypes.c_int64, ctypes.c_void_p
        lib.icr_pose_of.restype, lib.icr_twist_of.restype = Pose, Twist
        lib.icr_icrs_of.restype, lib.icr_health_of.restype = Icrs, ctypes.c_uint32
        lib.icr_state_of.restype = lib.icr_covariance_of.restype = real
        lib.icr_start_at.argtypes = [at] + [real] * 5
        lib.icr_tracks.argtypes = [at, stamp, real, real]
        lib.icr_imu.argtypes = [at, stamp, at, at]
        lib.icr_position.argtypes = [at, stamp] + [real] * 6
        lib.icr_heading.argtypes = [at, stamp, real, real]
        lib.icr_velocity.argtypes = [at, stamp] + [real] * 3
        lib.icr_zero_velocity.argtypes = [at, stamp, at]
        lib.icr_load.argtypes = [at, at, real]
        lib.icr_load.restype = ctypes.c_bool
        learnt = sum(one in LEARNT for one in self.states)
        self.saved_size = 16 + (learnt + learnt * learnt) * bits // 8
        self.memory = ctypes.create_string_buffer(65536)
        lib.icr_init(self.memory)

    def start(self, pose: tuple[float, float, float], sigma: float, yaw_sigma: float) -> None:
        self.lib.icr_start_at(self.memory, *pose, sigma, yaw_sigma)

    def saved(self) -> bytes:
        """Saved parameters."""
        kept = ctypes.create_string_buffer(self.saved_size)
        self.lib.icr_save(self.memory, kept)
        return kept.raw

    def load(self, kept: bytes, off: float) -> bool:
        """Start anew with saved parameters; False if they do not fit."""
        return bool(self.lib.icr_load(self.memory, kept, off))

    def feed(self, m: Measurement) -> int:
        """Result of a measurement."""
        lib, of = self.lib, self.memory
        match m:
            case TrackSpeeds():
                return int(lib.icr_tracks(of, m.stamp, m.left, m.right))
            case ImuSample():
                force = m.linear_acceleration
                forces = None if force is None else self.three(*force)
                return int(lib.icr_imu(of, m.stamp, self.three(*m.angular_velocity), forces))
            case PositionFix():
                values = m.x, m.y, m.variance, m.forward, m.left, m.up
                return int(lib.icr_position(of, m.stamp, *values))
            case HeadingFix():
                return int(lib.icr_heading(of, m.stamp, m.yaw, m.variance))
            case BodyVelocity():
                return int(lib.icr_velocity(of, m.stamp, m.v_x, m.v_y, m.variance))
            case ZeroVelocity():
                return int(lib.icr_zero_velocity(of, m.stamp, self.three(*m.sigma)))
        raise AssertionError(m)

    @property
    def pose(self) -> Any:
        return self.lib.icr_pose_of(self.memory)

    @property
    def twist(self) -> Any:
        return self.lib.icr_twist_of(self.memory)

    @property
    def icrs(self) -> Any:
        return self.lib.icr_icrs_of(self.memory)

    @property
    def health(self) -> int:
        return int(self.lib.icr_health_of(self.memory))

    @property
    def state(self) -> np.ndarray:
        places = range(len(self.states))
        return np.array([self.lib.icr_state_of(self.memory, k) for k in places])

    @property
    def covariance(self) -> np.ndarray:
        places, of = range(len(self.states)), self.lib.icr_covariance_of
        return np.array([[of(self.memory, i, j) for j in places] for i in places])


@dataclass
class Difference:
    """Largest differences from the estimator in Python, in standard deviations, and where they are."""

    state: float = 0.0
    covariance: float = 0.0
    twist: float = 0.0
    icrs: float = 0.0
    results: int = 0
    at: str = ""

    @property
    def worst(self) -> float:
        return max(self.state, self.covariance, self.twist)


def in_order(measurements: Iterable[Measurement]) -> list[Measurement]:
    return sorted(measurements, key=lambda one: (one.stamp, RANKS[type(one)]))


def compare(
    found: CFilter, expected: PoseEstimator, measurements: Iterable[Measurement], every: int = 29
) -> Difference:
    """Feed both filters; compare them at some measurements and at each fix."""
    off = Difference()
    for number, measurement in enumerate(in_order(measurements)):
        used, result = expected.feed(measurement), found.feed(measurement)
        if used != (result == USED):
            off.results += 1
            off.at = off.at or f"{measurement}: {used}, {result}"
        is_fix = not isinstance(measurement, TrackSpeeds | ImuSample)
        if expected.stamp is not None and (is_fix or number % every == 0):
            add_difference(off, found, expected, measurement)
    return off


def add_difference(
    off: Difference, found: CFilter, expected: PoseEstimator, measurement: Measurement
) -> None:
    there, states = expected.snapshot(), found.states
    P = there.covariance[np.ix_(states, states)]
    sigma = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    unit = np.where(sigma > LEAST_SIGMA, sigma, 1.0)
    of_state = np.abs(found.state - there.state[states]) / unit
    of_covariance = np.abs(found.covariance - P) / np.outer(unit, unit)
    worst = max(of_state.max(), of_covariance.max())
    if not worst <= max(off.state, off.covariance) * 3.0 and not worst < 1e-9:
        places = states[int(of_state.argmax())], *np.unravel_index(of_covariance.argmax(), P.shape)
        off.at = off.at or f"{worst:.2g} at {measurement}: state {places[0]}, P {places[1:]}"
    off.state = max(off.state, nan_is_large(of_state.max()))
    off.covariance = max(off.covariance, nan_is_large(of_covariance.max()))
    twist = found.twist
    spread = np.maximum(np.sqrt(np.diagonal(there.twist_covariance)), 1e-6)
    of_twist = np.array([twist.v_x, twist.v_y, twist.w]) - there.twist
    of_spread = np.array(twist.covariance).reshape(3, 3) - there.twist_covariance
    off.twist = max(
        off.twist,
        nan_is_large(np.abs(of_twist / spread).max()),
        nan_is_large(np.abs(of_spread / np.outer(spread, spread)).max()),
    )
    assert found.pose.stamp == there.stamp, measurement


def nan_is_large(value: float) -> float:
    return math.inf if math.isnan(value) else float(value)
