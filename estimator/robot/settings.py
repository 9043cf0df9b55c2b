"""Settings of the pose estimator that do not depend on the robot."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, get_args

import msgspec

from icreckon.estimator.base.checks import (
    Bound,
    Bounded,
    NotNegative,
    WanderSigma,
    WanderTime,
    check_bounds,
    require_choice,
    require_flag,
    require_kind,
    require_wander,
)
from icreckon.estimator.base.errors import SettingError
from icreckon.estimator.robot.robot_file import Robot, Slip
from icreckon.estimator.robot.variants import Adaptation

Engine = Literal["compiled", "plain"]

LONGEST_HISTORY = 60.0  # a re-run of a longer history would take too long [s]
LONGEST_TIME = 1e9  # largest valid time, thirty years [s]
_PATIENCE = Bound("a time of 0 s or more", 0.0, LONGEST_TIME)
_HISTORY = Bound(f"from 0 to {LONGEST_HISTORY:g} s", 0.0, LONGEST_HISTORY)
_SOME_TIME = Bound(
    f"a time of more than 0 s, and no more than {LONGEST_TIME:g} s", 0.0, LONGEST_TIME, above=True
)


class GateSettings(Bounded, frozen=True):
    """Settings of the chi-square gates.

    Attributes:
        patience: time of rejections in a row after which the next fix is used [s]; at 0 none is
            rejected. A fix counts at most 1 s, and one that is far away must be confirmed for as long as
            the robot would take to get there, or for six times this. Of the IMU, 0.1 s is enough.
    """

    NAMES: ClassVar[str] = "GateSettings.{}"
    patience: Annotated[float, _PATIENCE] = 10.0


# A shorter time contains no readings, and the readings of a longer one are kept in vain [s].
SHORTEST_STANDSTILL, LONGEST_STANDSTILL = 1e-3, 60.0
_LONG_ENOUGH = Bound(
    f"from {SHORTEST_STANDSTILL:g} to {LONGEST_STANDSTILL:g} s",
    SHORTEST_STANDSTILL,
    LONGEST_STANDSTILL,
)


class StandstillSettings(Bounded, frozen=True):
    """Conditions of standstill, all of which must hold.

    Attributes:
        track_speed: both tracks are slower than this [m/s]; at 0 standstill is never detected.
        duration: they are for at least this long [s], from 1 ms to 60 s.
        quiet_gyro: the yaw-rate readings of that time are within this of their mean [rad/s], or
            within five standard deviations of the file's noise if that is more; measured noise beyond
            that counts with eight.
    """

    NAMES: ClassVar[str] = "StandstillSettings.{}"
    track_speed: NotNegative = 0.005
    duration: Annotated[float, _LONG_ENOUGH] = 0.5
    quiet_gyro: NotNegative = 0.02


class FixWander(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Error of position fixes that wanders, as that of plain GPS does.

    It is a first-order Gauss-Markov process along x and along y of the frame of the fixes, in addition
    to the white noise of each fix. The filter estimates it as two more states.

    Attributes:
        sigma: its standard deviation along each axis [m]; 0 for fixes that do not wander.
        time: its correlation time [s]; needed unless `sigma` is 0.

    Raises:
        EstimatorError: a value is negative or not a finite number, or `sigma` is without a time.
    """

    sigma: WanderSigma = 0.0
    time: WanderTime = 0.0

    def __post_init__(self) -> None:
        check_bounds(self, "FixWander.{}")
        require_wander("FixWander.sigma", self.sigma, "FixWander.time", self.time)

    def at_start(self, sigma: float) -> float:
        """Standard deviation [m] of a start from fixes with this white `sigma` [m].

        The filter uses these fixes once more: it is so large that the start has no weight against them.
        """
        return math.hypot(sigma, 3.0 * self.sigma)

    @classmethod
    def of(cls, robot: Robot) -> FixWander:
        """Wander of a robot file's `[log.fixes]`, or of the fixes in its `[log.columns]`.

        Raises:
            EstimatorError: a value is not valid.
        """
        columns = robot.log.get("columns")
        of_columns = columns.get("fixes") if isinstance(columns, dict) else None
        for table in (robot.log.get("fixes"), of_columns):
            if isinstance(table, dict) and table.get("wander_sigma"):
                return cls(table["wander_sigma"], table.get("wander_time", 0.0))
        return cls()


class Settings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the filter, with tuned defaults.

    Attributes:
        engine: "compiled" by numba (making the first estimator ever takes some 20 s), or "plain"
            Python, number by number, for debugging: almost 300 times slower. They agree to rounding.
        slip: the slip residual, or None for the variant's default.
        adaptation: prior and random walk of the parameters, or None for the variant's default.
        hold: age from which track speeds are stale; more than the interval of the tracks [s].
        gap_acceleration: random walk of track speeds that are stale or stuck [m/s/√s].
        history: largest delay of a measurement behind newer ones [s]. It is processed at its own stamp,
            and later measurements are re-run; older ones are rejected. At 0, no measurement older than
            the newest is accepted.
        longest_gap: a stamp this much ahead of the newest is rejected, unless ten in a row are [s].
        use_accelerometer: True if the accelerometers update the filter.
        considered: names of consider states (Schmidt-Kalman): parameters, biases and scales (see
            `state_names`) that keep value and standard deviation, and contribute to the covariance.
        gates: chi-square gates.
        standstill: standstill detection.
        wander: error of position fixes that wanders; None for that of the robot file's fixes, see
            `FixWander.of`.

    Raises:
        EstimatorError: an unknown choice, a value that is out of range or not a finite number, or a
            value of a wrong type in place of a structure of settings.
    """

    engine: Engine = "compiled"
    slip: Slip | None = None
    adaptation: Adaptation | None = None
    hold: Annotated[float, _SOME_TIME] = 0.3
    gap_acceleration: NotNegative = 1.0
    history: Annotated[float, _HISTORY] = 1.0
    longest_gap: Annotated[float, _SOME_TIME] = 100.0
    use_accelerometer: bool = True
    considered: tuple[str, ...] = ()
    gates: GateSettings = GateSettings()
    standstill: StandstillSettings = StandstillSettings()
    wander: FixWander | None = None

    def __post_init__(self) -> None:
        require_choice("Settings.engine", self.engine, get_args(Engine))
        require_kind("Settings.slip", self.slip, Slip, or_none=True)
        require_kind("Settings.adaptation", self.adaptation, Adaptation, or_none=True)
        require_kind("Settings.gates", self.gates, GateSettings)
        require_kind("Settings.standstill", self.standstill, StandstillSettings)
        require_kind("Settings.wander", self.wander, FixWander, or_none=True)
        check_bounds(self, "Settings.{}")
        require_flag("Settings.use_accelerometer", self.use_accelerometer)
        names = self.considered
        if not (isinstance(names, tuple) and all(isinstance(name, str) for name in names)):
            raise SettingError(
                "Settings.considered must be a tuple of names of states, as in ('gyro_scale',), "
                f"found {names!r}"
            )


def wander_of(robot: Robot, settings: Settings) -> FixWander:
    """Wander of the fixes that a filter estimates: of the settings, else of the robot.

    Raises:
        EstimatorError: a value in the robot file is not valid.
    """
    return FixWander.of(robot) if settings.wander is None else settings.wander
