"""Settings of the pose estimator that do not depend on the robot."""

from __future__ import annotations

from typing import Literal, get_args

import msgspec

from icreckon.estimator.base.checks import (
    is_finite,
    is_whole,
    require_choice,
    require_flag,
    require_from,
    require_kind,
    require_not_negative,
)
from icreckon.estimator.base.errors import SettingError
from icreckon.estimator.motion.index_model import Form
from icreckon.estimator.robot.robot_file import Slip
from icreckon.estimator.robot.variants import Adaptation

Engine = Literal["compiled", "plain"]
Inertia = Literal["tracks", "imu"]

# A re-run of a longer history would take too long [s].
LONGEST_HISTORY = 60.0
# Largest valid time, thirty years [s].
LONGEST_TIME = 1e9


class GateSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the chi-square gates.

    Attributes:
        patience: number of consecutive rejections after which the next sample is accepted; at 0 none
            is rejected.

    Raises:
        EstimatorError: `patience` is not a whole number of at least 0.
    """

    patience: int = 10

    def __post_init__(self) -> None:
        if not is_whole(self.patience) or self.patience < 0:
            raise SettingError(
                f"GateSettings.patience must be a whole number, 0 or more, found {self.patience!r}"
            )


# A shorter time contains no readings [s].
SHORTEST_STANDSTILL = 1e-3


class StandstillSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Conditions of standstill, all of which must hold.

    Attributes:
        track_speed: both tracks are slower than this [m/s]; at 0 standstill is never detected.
        duration: they are for at least this long [s], no less than 1 ms.
        quiet_gyro: the yaw-rate readings of that time are within this of their mean [rad/s], or
            within five standard deviations of their noise if that is more.
        bias_margin: their mean is within this of the bias estimate [rad/s], or within four standard
            deviations of the bias estimate if that is more.

    Raises:
        EstimatorError: a value is negative or not a finite number, or `duration` is too short.
    """

    track_speed: float = 0.005
    duration: float = 0.5
    quiet_gyro: float = 0.02
    bias_margin: float = 0.03

    def __post_init__(self) -> None:
        for name in ("track_speed", "quiet_gyro", "bias_margin"):
            require_not_negative(f"StandstillSettings.{name}", getattr(self, name))
        require_from(
            "StandstillSettings.duration",
            self.duration,
            SHORTEST_STANDSTILL,
            f"at least {SHORTEST_STANDSTILL:g} s",
        )


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the filter, with tuned defaults.

    Attributes:
        engine: "compiled" by numba (making the first estimator ever takes some 20 s), or "plain"
            Python, which is eight times slower; they agree to rounding.
        form: "smooth" (signed inertia) or "literal" (the paper's |F| and signs); not for `friction`.
        inertia: "tracks" (of the kinematic twist) or "imu" (with the slip estimated from the IMU); not
            for `friction`.
        slip: the slip residual, or None for the variant's default.
        adaptation: prior and random walk of the parameters, or None for the variant's default.
        hold: age from which track speeds are stale [s].
        gap_acceleration: random walk of stale track speeds [m/s/√s].
        history: largest delay of a measurement behind newer ones [s]. It is processed at its own stamp,
            and later measurements are re-run; older ones are rejected. At 0, no measurement older than
            the newest is accepted.
        longest_gap: a stamp this much ahead of the newest is rejected, unless ten in a row are [s].
        use_accelerometer: True if the accelerometers update the filter.
        considered: names of consider states (Schmidt-Kalman): parameters, biases and scales (see
            `state_names`) that keep value and standard deviation, and contribute to the covariance.
        gates: chi-square gates.
        standstill: standstill detection.

    Raises:
        EstimatorError: an unknown choice, a value that is out of range or not a finite number, or a
            value of a wrong type in place of a structure of settings.
    """

    engine: Engine = "compiled"
    form: Form = "smooth"
    inertia: Inertia = "tracks"
    slip: Slip | None = None
    adaptation: Adaptation | None = None
    hold: float = 0.3
    gap_acceleration: float = 1.0
    history: float = 1.0
    longest_gap: float = 100.0
    use_accelerometer: bool = True
    considered: tuple[str, ...] = ()
    gates: GateSettings = GateSettings()
    standstill: StandstillSettings = StandstillSettings()

    def __post_init__(self) -> None:
        for name, choices in (("engine", Engine), ("form", Form), ("inertia", Inertia)):
            require_choice(f"Settings.{name}", getattr(self, name), get_args(choices))
        require_kind("Settings.slip", self.slip, Slip, or_none=True)
        require_kind("Settings.adaptation", self.adaptation, Adaptation, or_none=True)
        require_kind("Settings.gates", self.gates, GateSettings)
        require_kind("Settings.standstill", self.standstill, StandstillSettings)
        for name in ("hold", "longest_gap"):
            value = getattr(self, name)
            if not (is_finite(value) and 0.0 < value <= LONGEST_TIME):
                raise SettingError(
                    f"Settings.{name} must be a time of more than 0 s, and no more than "
                    f"{LONGEST_TIME:g} s, found {value!r}"
                )
        require_not_negative("Settings.gap_acceleration", self.gap_acceleration)
        require_flag("Settings.use_accelerometer", self.use_accelerometer)
        names = self.considered
        if not (isinstance(names, tuple) and all(isinstance(name, str) for name in names)):
            raise SettingError(
                "Settings.considered must be a tuple of names of states, as in ('gyro_scale',), "
                f"found {names!r}"
            )
        if not (is_finite(self.history) and 0.0 <= self.history <= LONGEST_HISTORY):
            raise SettingError(
                f"Settings.history must be from 0 to {LONGEST_HISTORY:g} s, found {self.history!r}"
            )
